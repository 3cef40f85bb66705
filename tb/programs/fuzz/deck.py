# SPDX-License-Identifier: Apache-2.0
"""The forms of lines that a deck may hold: elements between named nodes, numbers, known dot lines.

Any other line is a finding: text of a scene that reaches ngspice could run commands.
"""

import re
from collections.abc import Iterable
from contextlib import suppress
from functools import cache

from dermis.chip import sky130
from dermis.errors import InputError
from dermis.scene.design import ROOT, TOPOLOGIES

_NUMBER = r"-?[0-9]{1,40}(?:\.[0-9]{1,40})?(?:e[+-]?[0-9]{1,3})?"
_NAME = "[a-z][a-z0-9_.]*"
_ANY = "[a-z0-9_]+"
_NODES = rf"(?: (?:0|{_NAME}))"

_DECK = re.compile(
    "|".join(
        (
            rf"dermis frame [0-9]+: [0-9]+ x [0-9]+, (?:{'|'.join(TOPOLOGIES)})",  # title
            rf"[ceirv]{_ANY}{_NODES}{{2,4}} (?:{_NUMBER}|external)",  # element with a value
            rf"vbias vbias 0 sin\({_NUMBER}(?: {_NUMBER}){{5}}\)",  # ripple
            rf"b{_ANY}{_NODES}{{2}} i = v\({_NAME},{_NAME}\)\*\({_NUMBER} \+ \({_NUMBER}\)\*time\)",
            rf"x{_ANY}{_NODES}+(?: {_NAME}={_NUMBER})*",  # subcircuit
            rf"\+{_NODES}+",  # pins of the array
            r"\.(?:subckt|ends) array",
            rf"\.temp {_NUMBER}",
            rf"\.(?:param|options)(?: {_NAME}=(?:{_NUMBER}|gear|trap))+",
            *map(re.escape, sky130.REFERENCE),
        )
    )
)
_PARAMETERS = rf"\.param [a-z][a-z0-9_]* = {_NUMBER}|\*[ -~]*"


@cache
def includes() -> frozenset[str]:
    """Return the lines that include a file of spice/ or the models of a corner, by its whole path."""
    files = [ROOT / "spice" / name for name in ("design.inc", "behavioural/blocks.inc", "sky130/devices.inc")]
    files += [path for view in ("behavioural", "sky130") for path in (ROOT / "spice" / view).glob("*.sp")]
    with suppress(InputError):  # without the models no deck includes any
        files += [sky130.models(corner) for corner in sky130.CORNERS]
    return frozenset(f'.include "{file}"' for file in files)


def strange_lines(lines: Iterable[str]) -> list[str]:
    """Return the lines without an allowed form; a line with a line end inside is one of them."""
    return [line for line in lines if line not in includes() and not _DECK.fullmatch(line)]


def strange_parameters(text: str) -> list[str]:
    """Return the lines of a parameter file that are neither `.param name = number` nor a comment."""
    return [line for line in text.split("\n") if line and not re.fullmatch(_PARAMETERS, line)]
