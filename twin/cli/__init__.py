"""The command line: runs, pages, files to start from, the installation; other commands are made of their studies."""


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    import sys

    from twin.kernel.process.job import interruption, keep_interrupts, terminable

    keep_interrupts()
    try:
        from twin.cli.ahead import job_expected

        with terminable(), job_expected():
            from twin.cli.line import main

            main()
    except KeyboardInterrupt:
        # while the commands themselves are being imported, or at the very end
        code, word = interruption()
        print(word, file=sys.stderr)
        sys.exit(code)
