# SPDX-License-Identifier: Apache-2.0
"""The clocks of a row slot."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Timing:
    """Clocks of one row slot: preset for settle_clocks, then count for gate_clocks.

    Through the first break_clocks of the settle clocks no row is driven. A frame begins settled
    where row 0 is driven, break_clocks into its first slot.
    """

    f_clk_hz: float
    slot_clocks: int
    settle_clocks: int
    gate_clocks: int
    code_max: int
    rows: int
    # A one decided at clock n pulls its packet out between clocks n + delay and n + delay + 1: the second
    # flip-flop.
    charge_delay_clocks: float = 1.0
    break_clocks: int = 0

    @property
    def slot_s(self) -> float:
        """Length of a row slot in seconds."""
        return self.slot_clocks / self.f_clk_hz

    @property
    def frame_s(self) -> float:
        """Length of a frame in seconds."""
        return self.rows * self.slot_s
