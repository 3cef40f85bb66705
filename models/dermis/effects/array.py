# SPDX-License-Identifier: Apache-2.0
"""Effects of the array: sheet, row drivers, wires, inputs of the columns."""

from typing import Annotated

from pydantic import Field

from dermis.effects.effect import column, exact_effect, not_negative, positive

_OrInfinite = Annotated[float, Field(ge=0, allow_inf_nan=True)]

EFFECTS = (
    exact_effect(
        "lateral",
        "conductance of the sheet: resistors between neighbouring taxels, along rows and columns",
        {"r_ohm": positive("Between inner electrodes of neighbouring taxels, in ohm", 2e3, (100.0, 1e4))},
        {"r_ohm": "array.r_lateral_ohm"},
        network=dict.fromkeys(("g_lateral_row_s", "g_lateral_column_s"), lambda p, _: 1.0 / p.r_ohm),
        needs={"column_input": {"r_ohm": 5.0}},
    ),
    exact_effect(
        "row_driver",
        "on-resistance of the row drivers: the driven row droops, the grounded rows rise",
        {
            "r_ohm": not_negative("In series with the driven row, in ohm", 3.0, (0.1, 30.0)),
            "grounded_r_ohm": not_negative(
                "In series with every grounded row, in ohm; inf leaves them floating",
                5.0,
                (0.1, 30.0),
                kind=_OrInfinite,
            ),
        },
        {"r_ohm": "row_driver.r_on_ohm", "grounded_r_ohm": "row_driver.r_ground_ohm"},
        network={"r_row_driven_ohm": "r_ohm", "r_row_grounded_ohm": "grounded_r_ohm"},
        follows={"grounded_r_ohm": "r_ohm"},
    ),
    exact_effect(
        "pad",
        "resistance of pads and wires in series with rows and columns",
        {
            "r_row_ohm": not_negative("From the driver of a row to the sheet, in ohm", 3.0, (0.01, 150.0)),
            "r_column_ohm": not_negative("From the sheet to a column's input, in ohm", 1.0, (0.01, 150.0)),
        },
        {"r_row_ohm": "wires.r_pad_row_ohm", "r_column_ohm": "wires.r_pad_column_ohm"},
        network={
            **dict.fromkeys(("r_row_driven_ohm", "r_row_grounded_ohm", "r_pad_row_ohm"), "r_row_ohm"),
            **dict.fromkeys(("r_column_ohm", "r_pad_column_ohm"), "r_column_ohm"),
        },
        # Columns of the direct interface that give way would move each other by a count: cosim alone takes that.
        direct={"r_row_ohm": 1.0, "r_column_ohm": 0.0},
        considered=False,
    ),
    exact_effect(
        "return",
        "common return of the grounded rows: their current raises all of them",
        {"r_ohm": not_negative("From the ground of the row drivers to ground, in ohm", 30.0, (0.01, 30.0))},
        {"r_ohm": "wires.r_return_ohm"},
        network={"r_return_ohm": "r_ohm"},
        needs={"column_input": {"r_ohm": 5.0}},
        considered=False,
    ),
    exact_effect(
        "column_input",
        "input resistance of the columns, in series with the virtual ground",
        {"r_ohm": column("Between every column and its virtual ground, in ohm", 20.0, (0.1, 30.0), ge=0)},
        {"r_ohm": ("conveyor.r_x_ohm", None)},
        network={"r_column_ohm": "r_ohm"},
    ),
    exact_effect(
        "column_offset",
        "offset of the virtual ground: a current through every taxel of the column",
        {"v_v": column("Voltage of the virtual ground, in V", 2e-4, (1e-5, 5e-3))},
        {"v_v": ("conveyor.v_offset_v", "integrator.v_offset_v")},
        network={"v_column_offset_v": "v_v"},
    ),
    exact_effect(
        "mux_leakage",
        "leakage of open switches into the columns, before the mirror",
        {"i_a": column("Into the line of every column, in A", 2e-5, (1e-10, 1e-5))},
        {"i_a": "row_driver.i_leak_a"},
        network={"i_leak_a": "i_a"},
    ),
)
