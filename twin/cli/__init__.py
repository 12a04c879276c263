"""The command line: runs, pages, files to start from, the installation; other commands are made of their studies."""


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    try:
        from twin.kernel.process.job import keep_interrupts, terminable

        keep_interrupts()
        from twin.cli.ahead import job_expected

        with terminable(), job_expected():
            from twin.cli.line import main

            main()
    except KeyboardInterrupt:
        # while the commands themselves are being imported, or at the very end
        import sys

        code, word = 130, "interrupted"
        if job := sys.modules.get("twin.kernel.process.job"):
            code, word = getattr(job, "interruption", lambda: (code, word))()
        print(word, file=sys.stderr)
        sys.exit(code)
