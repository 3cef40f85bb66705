# SPDX-License-Identifier: Apache-2.0
"""What of a netlist would end the process of ngspice, stop it without being named, or be ignored."""

from __future__ import annotations

import difflib
import functools
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from dermis.errors import InputError

_OPENS, _CLOSES = (".subckt", ".if"), (".ends", ".endif")
_ANALYSES = r"\.(ac|dc|op|tran|noise|disto|pz|sens|tf|sp|pss|four|meas\w*)\b"
_WATCHED = re.compile(
    rf"\*#|[viatoyp]|\.(control|subckt|ends|if|endif|inc|lib|opt)|{_ANALYSES}", re.IGNORECASE
)
_BREAKS = re.compile(r"[atoyp]|\.lib|[vi].*[\s=](pulse|pwl|exp|pat|trnoise|trrandom)\b", re.IGNORECASE)
"""Cards of sources with corners, delayed lines, digital events, and files that are not read here."""
_ELEMENTS = re.compile(r"\s*([a-z]|\.inc|\.lib)", re.IGNORECASE)
"""An element, or a file that may have one."""
_INCLUDES = 10
"""Depth of files in files that is followed; ngspice ends a circle itself."""

_OPTIONS = (
    "abstol absdv acct autostop badmos3 bypass chgtol convabsstep convlimit convstep copynodesets cshunt defad defas "
    "defl defm defw delmin epsmin gmin gminfactor gminsteps gshunt indverbosity itl1 itl2 itl3 itl4 itl5 itl6 "
    "keepopinfo klu list maxevtiter maxopalter maxord maxwarns method minbreak newtrunc noacct node nodedamping noinit "
    "nomod noopac noopalter noopiter nopage num_threads numdgt oldlimit opts pivrel pivtol post ramptime reldv reltol "
    "rseries rshunt savecurrents scale seed seedinfo sparse srcsteps temp tnom trtol trytocompact vntol warn xmu xtrtol"
).split()

_Place = tuple[str, str]


def refuse(lines: Sequence[str]) -> None:
    """Refuse a netlist by its first line that cannot be simulated in lock-step, with an InputError that names it.

    - An external source with a value: libngspice 39 crashes (exit 139).
    - An external current source: nothing drives it.
    - `.control`, and a comment `*#`: their commands run while the deck is read, and `quit` ends ngspice.
    - The option `interp`: samples would be those of other times, also in later circuits.
    - An option with a value whose name is nearly one of ngspice's, which takes any name and does nothing with it.
    - A lossy line of type `o`: ngspice takes memory for all steps that the longest run could have.
    - An analysis, such as `.tran` with `uic`: it would not be run.
    - Two voltage sources across the same nodes, outside subcircuits: a singular matrix, which ngspice reports
      for one of their branches.
    - `.subckt` or `.if` without its end, or no element at all: ngspice takes no other circuit after it, or hangs.

    The first of the `lines` is the title. Files of `.include` are read as well, those of `.lib` not.
    """
    if not any(_ELEMENTS.match(line) for line in lines[1:]):
        raise InputError("netlist", "elements", 0, "at least one, after the line of the title")
    across: dict[frozenset[str], str] = {}
    opened: list[tuple[str, str, str]] = []
    for place, line in _cards(lines[1:], Path("netlist"), 2):
        words = re.split(r"[\s=(),]+", line.lower().strip())
        name, ends, value = words[0], frozenset("0" if w == "gnd" else w for w in words[1:3]), words[3:]
        if name == ".control" or name.startswith("*#"):
            allowed = "no .control block or *# command: the co-simulation gives the commands"
            raise InputError(*place, line, allowed)
        if name.startswith(".opt") and "interp" in words:
            raise InputError(*place, line, "without interp, which moves the samples to other times")
        # Files of a process have options of other simulators as well.
        if name.startswith(".opt") and place[0] == "netlist":
            for word in re.findall(r"([a-z]\w*)\s*=", line.lower()):
                if word not in _OPTIONS and (near := difflib.get_close_matches(word, _OPTIONS, 1, 0.8)):
                    raise InputError(*place, line, f"ngspice has no option {word}; is it {near[0]}?")
        if name[0] == "o":
            raise InputError(*place, line, "a lossless line t, or a lossy one of type y (txl)")
        if re.fullmatch(_ANALYSES, name):
            raise InputError(*place, line, "no analysis: the co-simulation runs its own transient")
        if name[0] not in "vi.":
            continue
        if name.startswith(_OPENS):
            opened.append((*place, line))
        elif name in _CLOSES and opened:
            opened.pop()
        if "external" in value and name[0] == "i":
            allowed = "an external voltage source that controls a current source: g1 node node control 0 1"
            raise InputError(*place, line, allowed)
        if "external" in value and value != ["external"]:
            raise InputError(*place, line, "name node node external; a value here crashes ngspice")
        if name[0] != "v" or opened:
            continue
        if (other := across.setdefault(ends, f"{place[0]}, {place[1]}")) != f"{place[0]}, {place[1]}":
            raise InputError(*place, line, f"no voltage source in parallel with that of {other}")
    if opened:
        raise InputError(*opened[-1], ".ends or .endif after it")


def refuse_redefinition(said: str) -> None:
    """Refuse a subcircuit with the name of another, which ngspice ignores and `said` in passing."""
    if found := re.search(r"redefinition of \.subckt ([^\s,]+)", said):
        raise InputError(
            "netlist", ".subckt", found[1], "one subcircuit of a name: ngspice ignores the second"
        )


def breaks(lines: Sequence[str]) -> bool:
    """Return True if ngspice may have breakpoints of its own in a netlist; `lines` as in `refuse`."""
    return any(_BREAKS.match(card) for _, card in _cards(lines[1:], Path("netlist"), 2))


def _cards(lines: Iterable[str], file: Path, first: int, depth: int = 0) -> Iterator[tuple[_Place, str]]:
    """Yield the lines that are looked at, continued ones joined, with file and line."""
    number, card = 0, ""
    for at, line in enumerate((*lines, ""), first):
        if line.startswith("*") and not line.startswith("*#"):  # may stand before a continuation
            continue
        if line.startswith("+"):
            card += f" {line[1:]}"
            continue
        if _WATCHED.match(card):
            yield (file.name, f"line {number}"), card
            found = re.match(r"\.inc\w*\s+[\"']?([^\"']+)", card, re.IGNORECASE)
            if found and depth < _INCLUDES and (inside := file.parent / found[1].strip()).is_file():
                yield from _cards_of(inside, inside.stat().st_mtime_ns, depth + 1)
        number, card = at, re.split(r";|\s\$", line.lstrip())[0].rstrip()


@functools.cache
def _cards_of(file: Path, _: int, depth: int) -> list[tuple[_Place, str]]:
    """Return the cards of an included file, read again after a change."""
    return list(_cards(file.read_text(encoding="utf-8", errors="replace").splitlines(), file, 1, depth))
