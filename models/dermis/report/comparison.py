# SPDX-License-Identifier: Apache-2.0
"""Comparison of codes with a neighbouring engine and with a straight line over force."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dermis import engines
from dermis.engines import Result
from dermis.errors import InputError, counted
from dermis.records import Plan
from dermis.report import verdict
from dermis.report.verdict import Row
from dermis.scene.sensor import InverseSensor
from dermis.scene.views import BEHAVIOURAL

# 510 x of a force that was computed from a code is that code within a few ulp; other forces are further away.
_EXACT = 1e-9


def on_code(made: Plan) -> NDArray[np.bool_]:
    """Return where x = c / gate_clocks, or full scale: rounding cannot change these codes."""
    steps = made.timing.gate_clocks * made.duty_ideal()
    with np.errstate(invalid="ignore"):
        whole = np.abs(steps - np.round(steps)) <= _EXACT * np.maximum(steps, 1.0)
    return whole | (steps >= made.timing.code_max)


def fit_residual(made: Plan, codes: NDArray[Any]) -> tuple[float, float, NDArray[np.float64]] | None:
    """Fit a straight line to code against force below saturation: slope per newton, offset, residuals; or None.

    None as well where codes do not follow force in one line: another law than Force = K/R, a sheet
    that has aged, or columns of different k.
    """
    if not isinstance(made.sensor, InverseSensor) or np.ptp(made.converter.k):
        return None
    if not np.allclose(made.sensor.force_n(made.resistance_ohm), made.force_n, rtol=_EXACT, atol=0):
        return None
    steps = made.timing.gate_clocks * made.duty_ideal()
    below = np.isfinite(made.force_n) & (steps <= made.timing.code_max)
    force, code = made.force_n[below], codes[below].astype(float)
    if np.unique(force).size < 3:
        return None
    slope, offset = np.polyfit(force, code, 1)
    return float(slope), float(offset), code - (slope * force + offset)


def _reference(made: Plan) -> str | None:
    """Return the engine to compare with, `closed` or `event`; None if neither can do the plan."""
    # Not engines.cheapest: an engine that refuses a value becomes a SKIP row with its reason.
    return next((e for e in ("closed", "event") if e != made.engine and not engines.refused(made, e)), None)


def _no_reference(made: Plan) -> str:
    """Return why nothing is compared, and the engines whose runs can be."""
    others = [e for e in ("rtl", "cosim") if e != made.engine and not engines.refused(made, e)]
    advice = f"; compare with a run of {' or '.join(others)}" if others else ""
    return f"neither closed nor event is another engine that has its effects{advice}"


def _compare_transistors(made: Plan, codes: NDArray[Any], name: str) -> list[Row]:
    """Return rows for transistors against ideal blocks, as read and after calibration."""
    ideal = replace(made, views=BEHAVIOURAL)
    key = f"frame.transistor_error_lsb.{name}"
    if (reference := _reference(ideal)) is None:
        return [verdict.skip(key, _no_reference(made))]
    exact = engines.run(replace(ideal, engine=reference)).codes.astype(float)
    inside = (exact > 0) & (exact < made.timing.code_max) & (codes < made.timing.code_max)
    note = f"{codes.size} codes against engine {reference}, as read: gain and offset of the channels"
    rows = [verdict.report(key, float(np.abs(codes - exact).max()), "lsb", note)]
    rest = []
    for column in range(made.cols):
        x, y = (some[:, :, column][inside[:, :, column]] for some in (exact, codes))
        if np.unique(x).size >= 3:
            rest.append(np.abs(y - np.polyval(np.polyfit(x, y, 1), x)).max())
    key = f"frame.transistor_residual_lsb.{name}"
    if not rest:
        return [*rows, verdict.skip(key, "no column has three codes to fit a line to", "lsb")]
    note = f"{len(rest)} columns, gain and offset of each taken away; both codes are whole numbers"
    return [*rows, verdict.judge(key, float(max(rest)), note)]


def first_frames(made: Plan, result: Result, name: str, taxels: int) -> list[Row]:
    """Judge the first frames that hold `taxels` taxels in all, as `compare` does."""
    frames = min(made.frames, -(-taxels // (made.rows * made.cols)))
    rows = compare(made.part(0, frames), Result(result.codes[:frames]), name)
    return [{**row, "note": f"{row['note']}; {counted(frames, 'frame', made.frames)}"} for row in rows]


def compare(made: Plan, result: Result, name: str, expected: NDArray[Any] | None = None) -> list[Row]:
    """Compare the codes of a run with a neighbouring engine, with a straight line, and with the codes of a frame file.

    `name` is the last part of the rows' names; `expected` are the codes that the file holds.
    """
    codes = result.codes.astype(int)
    if made.views.in_transistors(made.topology):
        return _compare_transistors(made, codes, name)
    rows: list[Row] = []
    refused, reference = "", _reference(made)
    if reference is None:
        refused = _no_reference(made)
    else:
        try:
            error = np.abs(codes - engines.run(replace(made, engine=reference)).codes)
        except InputError as refusal:  # it honours the fields, but not these values
            refused = str(refusal)
    if refused:
        rows.append(verdict.skip(f"frame.code_error_lsb.{name}", refused))
    else:
        exact = np.zeros(codes.shape, bool) if made.active_fields() else on_code(made)
        for kind, where in (("code_error_exact_lsb", exact), ("code_error_lsb", ~exact)):
            if where.any():
                note = f"{int(where.sum())} codes against engine {reference}"
                rows.append(verdict.judge(f"frame.{kind}.{name}", int(error[where].max()), note))
    if not made.active_fields() and (fit := fit_residual(made, codes)) is not None:
        note = f"code = {fit[0]:.4f} / N x force {fit[1]:+.3f}"
        rows.append(verdict.judge(f"frame.fit_residual_lsb.{name}", float(np.abs(fit[2]).max()), note))
    if expected is not None:
        worst = int(np.abs(codes - expected).max())
        note = f"{counted(made.frames, 'frame')} of the file"
        rows.append(verdict.judge(f"frame.readback_error_lsb.{name}", worst, note))
    return rows
