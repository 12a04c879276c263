"""The command line: runs, pages, new files, the installation; other commands are generated from the studies."""


def main() -> None:
    """Run twin's command line and end the process with its exit code."""
    import os
    import sys

    # a notebook exports a backend that may be missing here; pictures need no display
    os.environ["MPLBACKEND"] = "agg"
    try:
        from twin.kernel.process.job import handle_termination, retry_lost_interrupts

        retry_lost_interrupts()
        from twin.cli.ahead import start_expected_job

        with handle_termination(), start_expected_job():
            from twin.cli.line import main

            main()
    except KeyboardInterrupt:
        # during the import of the commands, or at the very end
        code, word = 130, "interrupted"
        if job := sys.modules.get("twin.kernel.process.job"):
            code, word = getattr(job, "interruption", lambda: (code, word))()
        print(word, file=sys.stderr)
        sys.exit(code)
    except Exception:
        # an error before a command is read, such as a broken installation; `twin.cli.line` reports all others
        from twin.kernel.errors import InternalError, internal_error

        print(internal_error(), file=sys.stderr)
        sys.exit(InternalError.exit_code)
