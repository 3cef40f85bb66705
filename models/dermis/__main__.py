# SPDX-License-Identifier: Apache-2.0
"""The way into the command line, `dermis` as well as `python -m dermis`: answers Ctrl-C from its first line on."""

import signal


def _leave(number: int, _: object) -> None:
    import os

    os.write(2, b"interrupted\n" if number == signal.SIGINT else b"terminated\n")
    os._exit(128 + number)


def main() -> None:
    """Load the command line, which takes some tenths of a second and has nothing to tidy up, and run it."""
    # Before any import but that of signal, each of which would be a traceback.
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:  # a shell has it so for what runs behind it
            signal.signal(number, _leave)
    from dermis import cli

    cli.main()


if __name__ == "__main__":
    main()
