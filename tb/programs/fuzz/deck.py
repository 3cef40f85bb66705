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

NUMBER = r"-?[0-9]{1,40}(?:\.[0-9]{1,40})?(?:e[+-]?[0-9]{1,3})?"
_NAME = "[a-z][a-z0-9_.]*"
_ANY = "[a-z0-9_]+"
_NODES = rf"(?: (?:0|{_NAME}))"

_DECK = re.compile(
    "|".join(
        (
            rf"dermis frame [0-9]+: [0-9]+ x [0-9]+, (?:{'|'.join(TOPOLOGIES)})",  # title
            rf"[ceirv]{_ANY}{_NODES}{{2,4}} (?:{NUMBER}|external)",  # element with a value
            rf"vbias vbias 0 sin\({NUMBER}(?: {NUMBER}){{5}}\)",  # ripple
            rf"b{_ANY}{_NODES}{{2}} i = v\({_NAME},{_NAME}\)\*\({NUMBER} \+ \({NUMBER}\)\*time\)",
            rf"x{_ANY}{_NODES}+(?: {_NAME}={NUMBER})*",  # subcircuit
            rf"\+{_NODES}+",  # pins of the array
            r"\.(?:subckt|ends) array",
            rf"\.temp {NUMBER}",
            rf"\.(?:param|options)(?: {_NAME}=(?:{NUMBER}|gear|trap))+",
            *map(re.escape, sky130.REFERENCE),
        )
    )
)


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
