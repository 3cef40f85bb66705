# SPDX-License-Identifier: Apache-2.0
"""Entry of `dermis` and `python -m dermis`; handles Ctrl-C from its first line on."""

import signal


def _leave(number: int, _: object) -> None:
    import os

    os.write(2, b"interrupted\n" if number == signal.SIGINT else b"terminated\n")
    os._exit(128 + number)


def main() -> None:
    """Load the command line, which takes some tenths of a second, and run it."""
    # Before any import but that of signal, each of which would be a traceback.
    numbers = signal.SIGINT, signal.SIGTERM, signal.SIGHUP
    for number in numbers:
        if signal.getsignal(number) is not signal.SIG_IGN:  # a shell has it so for what runs behind it
            signal.signal(number, _leave)
    from dermis import cli

    try:
        cli.main()
    finally:
        # The interpreter gives signals back their default action as it ends: one more Ctrl-C would be an end with -2.
        for number in numbers:
            signal.signal(number, signal.SIG_IGN)


if __name__ == "__main__":
    main()
