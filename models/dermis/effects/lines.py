# SPDX-License-Identifier: Apache-2.0
"""Effects of the lines between taxels: their resistance and capacitance."""

from dermis.effects.effect import exact_effect, not_negative

EFFECTS = (
    exact_effect(
        "trace",
        "resistance of the lines, between taxels and to driver and column input",
        {
            "r_row_ohm": not_negative("Of a row line, a pitch, in ohm", 1.0, (0.01, 5.0)),
            "r_column_ohm": not_negative("Of a column line, a pitch, in ohm", 1.0, (0.01, 5.0)),
        },
        {"r_row_ohm": "array.r_trace_row_ohm", "r_column_ohm": "array.r_trace_column_ohm"},
        network={"r_trace_row_ohm": "r_row_ohm", "r_trace_column_ohm": "r_column_ohm"},
    ),
    exact_effect(
        "line_capacitance",
        "capacitance of lines and taxels: settling that is not complete when the gate opens",
        {
            "c_row_f": not_negative("Of every row line to ground, in F", 2e-11, (1e-11, 1e-8)),
            "c_column_f": not_negative("Of every column line to ground, in F", 2e-11, (1e-11, 1e-8)),
            "c_taxel_f": not_negative("Across every taxel, in F", 2e-13, (1e-13, 1e-10)),
        },
        {"c_row_f": "array.c_row_f", "c_column_f": "array.c_column_f", "c_taxel_f": "array.c_taxel_f"},
        network={"c_row_f": "c_row_f", "c_column_f": "c_column_f", "c_taxel_f": "c_taxel_f"},
        needs={"row_driver": {"r_ohm": 1e3}, "column_input": {"r_ohm": 1e3}},
    ),
)
