"""The command line: runs, pages, files to start from, the installation; other commands are made of their studies."""


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    import sys

    from twin.kernel.process.job import INTERRUPTED, keep_interrupts

    keep_interrupts()
    try:
        from twin.cli.ahead import job_expected

        with job_expected():
            from twin.cli.line import main

            main()
    except KeyboardInterrupt:
        # while the commands themselves are being imported, or at the very end
        print("interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
