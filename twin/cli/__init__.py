"""The command line: one file per command. Heavy packages are imported inside the commands that use them."""


def main() -> None:
    """Entry point; ends the process with the exit code of what happened."""
    from twin.cli.ahead import run_expected

    with run_expected():
        from twin.cli.app import main

        main()
