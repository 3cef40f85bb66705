# SPDX-License-Identifier: Apache-2.0
"""Runs a bench of spice/bench through ngspice in batch mode and returns what it measured, or says why not."""

import re
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from dermis.chip import spice_batch
from dermis.errors import SimulatorError
from dermis.scene.design import ROOT

SPICE = ROOT / "spice"
SECTIONS = ("include", "options", "parameters", "stimulus", "dut", "measure", "control")


@dataclass(frozen=True)
class Bench:
    """One bench, with what a test changes about it."""

    name: str  # file name in spice/bench without its suffix
    # Parameters for every instance named xdut...; one that the bench itself sets there stays as it is.
    dut: Mapping[str, float] = field(default_factory=dict)
    params: Mapping[str, float] = field(default_factory=dict)  # values for the bench's own .param lines
    # Netlist faults, {path below spice/: ((old, new), ...)}; each `old` must occur exactly once.
    edits: Mapping[str, Sequence[tuple[str, str]]] = field(default_factory=dict)
    options: str = ""  # text for one more .options line after the bench's own

    def write(self, folder: Path) -> Path:
        """Copy spice/ to `folder`, apply the changes there and return the deck."""
        shutil.copytree(SPICE, folder, dirs_exist_ok=True)
        for path, pairs in self.edits.items():
            text = (folder / path).read_text()
            for old, new in pairs:
                if text.count(old) != 1:
                    raise ValueError(f"{path}: {old!r} occurs {text.count(old)} times, not once")
                text = text.replace(old, new)
            (folder / path).write_text(text)
        deck = folder / "bench" / f"{self.name}.sp"
        deck.write_text(self._changed(deck.read_text()))
        return deck

    def _changed(self, text: str) -> str:
        for key, value in self.params.items():
            text, count = re.subn(rf"(?m)^\.param {key} = .*$", f".param {key} = {value!r}", text)
            if count != 1:
                raise ValueError(f"{self.name}: {count} lines .param {key}")
        if self.options:
            text = re.sub(r"(?m)^\* parameters", f".options {self.options}\n\\g<0>", text)

        def with_dut(instance: re.Match[str]) -> str:
            have = set(re.findall(r"(\w+)\s*=", instance[0]))
            return instance[0] + "".join(f"+ {k}={v!r}\n" for k, v in self.dut.items() if k not in have)

        text, found = re.subn(r"(?m)^xdut.*\n(?:\+.*\n)*", with_dut, text)
        if self.dut and not found:
            raise ValueError(f"{self.name}: no instance xdut")
        return text


def run(deck: Path, limit_s: float = 60.0) -> dict[str, float]:
    """Run a deck and return ``{name: value}`` for every ``.meas`` in it; errors as in dermis.chip.spice_batch.

    A bench that needs a retry is wrong, however well the retry goes.
    """
    measured = spice_batch.run(deck, limit_s)
    if measured.retries:
        raise SimulatorError(f"ngspice, {deck.stem}, {measured.retries[0]}", deck.with_suffix(".log"))
    return dict(measured.values)
