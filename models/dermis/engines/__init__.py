# SPDX-License-Identifier: Apache-2.0
"""Engines: each takes a plan and returns codes; any two can be compared."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from dermis import machine_code
from dermis.array import solve_error
from dermis.errors import InputError, quoted

if TYPE_CHECKING:
    from dermis.records import Plan


# Largest array for which a refusal asks each engine for its limits: an engine may solve a whole frame to answer, of
# coupled columns about 1 s of processor time on a sheet of 255 x 40.
_ASKED_CELLS = 32 * 32


@dataclass
class Result:
    """Codes [frames, rows, cols] of `vfc.code_type`, and further results of an engine."""

    codes: NDArray[np.unsignedinteger]
    info: dict[str, Any] = field(default_factory=dict)


def _module(name: str) -> Any:
    return importlib.import_module(f"dermis.engines.{name}")


def honours(engine: str) -> frozenset[str]:
    """Record fields an engine can do."""
    return _module(engine).HONOURS


def runner(engine: str) -> Callable[..., Result]:
    """The function that runs a plan in an engine, unchecked."""
    return _module(engine).run


def refused(plan: Plan, engine: str) -> frozenset[str]:
    """Record fields of a plan that are away from the ideal and that an engine cannot honour."""
    asked = getattr(_module(engine), "honours", None)
    return plan.active_fields() - (asked(plan) if asked else honours(engine))


def refuses(plan: Plan, engine: str) -> InputError | None:
    """Return the error of an engine that honours every field of a plan but not its values, or None; it may
    find more on its way through the frames.
    """
    asked = getattr(_module(engine), "refuses", None)
    return _refuses_views(plan, engine) or (asked(plan) if asked else None)


def _refuses_views(plan: Plan, engine: str) -> InputError | None:
    """Only decks have views: another engine would read a scene's transistors as ideal blocks."""
    if engine == "cosim" or not plan.views.in_transistors(plan.topology):
        return None
    allowed = '"cosim", or run.views = "behavioural"'
    return InputError(plan.scene.path, "run.engine", quoted(engine), allowed)


def _able(plan: Plan, values: bool = True) -> Iterator[str]:
    """Engines that honour every field of a plan, and unless asked otherwise its values; the cheapest first."""
    from dermis.records import ENGINES

    able = (name for name in ENGINES if not refused(plan, name))
    return (name for name in able if not values or refuses(plan, name) is None)


def cheapest(plan: Plan) -> str | None:
    """Return the cheapest engine that refuses nothing of a plan; None if there is none."""
    return next(_able(plan), None)


def check(plan: Plan) -> None:
    """Refuse a plan whose engine would have to ignore something: InputError with the effect and an able engine."""
    _check_fields(plan)
    _check_sources(plan)
    if error := refuses(plan, plan.engine):
        raise error


def _check_fields(plan: Plan) -> None:
    if plan.front_end is not None:
        allowed = "left out; boards are for dermis.Skin, dermis read and dermis calibrate"
        raise InputError(plan.scene.path, "front_end", f"not possible with engine {plan.engine}", allowed)
    if lost := refused(plan, plan.engine):
        large = plan.rows * plan.cols > _ASKED_CELLS
        able = list(_able(plan, values=not large))
        effects = sorted({effect for name in lost for effect in plan.effects_of_field(name)})
        what = f"effects.{effects[0]}" if effects else sorted(lost)[0]
        if not lost & plan.active_fields() - honours(plan.engine):  # only its views cannot
            allowed = 'run.views = "behavioural" for its block: a block of transistors takes no parameters'
            raise InputError(plan.scene.path, what, "not possible with these run.views", allowed)
        allowed = (
            f"engine {' or '.join(able)}{' where its values allow it' * large}"
            if able
            else "no engine can do all of this scene's effects together"
        )
        raise InputError(plan.scene.path, what, f"not possible with engine {plan.engine}", allowed)


def run(plan: Plan, progress: Callable[[int], None] | None = None, **options: Any) -> Result:
    """Run a plan through its engine, which must honour its fields; options go to the engine.

    info["array"] bounds the error of the array solves of the engine (solve_error.ErrorRecord).
    """
    _check_fields(plan)
    _check_sources(plan)
    if error := _refuses_views(plan, plan.engine):
        raise error
    with solve_error.recording(*_lsb(plan)) as record:
        filtered = plan.filtered and plan.engine == "event"
        engine = _module("filter" if filtered else plan.engine)
        machine_code.announce()
        result = engine.run(plan, progress, **options)
    if report := record.report():
        result.info["array"] = report
    return result


def _check_sources(plan: Plan) -> None:
    """Refuse a plan that has no solution: taxels of 0 ohm across ideal sources."""
    if not plan.network(0).v_column_offset_v.any():
        return
    from dermis.array import array

    try:
        array.refuse_loops(plan.network(0), plan.conductance_s())
    except array.NoSolution as error:
        frame, row, column = error.place
        raise InputError(
            plan.scene.path,
            f"resistance of the taxel at row {row}, column {column} in frame {plan.first_frame + frame}",
            "0 ohm",
            "above 0 where effects.column_offset is on and neither row_driver, column_input nor trace gives the "
            "current an end: it would join ideal sources of unlike voltages",
        ) from None


def _lsb(plan: Plan) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the column current [cols] that moves a code by one, and the largest that does."""
    c, timing = plan.converter, plan.timing
    gain = np.maximum(np.abs(c.gain), 1e-9)  # a gain of 0 reads nothing; any finite LSB will do for it
    lsb = c.k * c.i0_a / gain / timing.gate_clocks
    start = (np.abs(c.v_comp_offset_v) + np.abs(c.preset_error_v)) / c.packet_v()
    return lsb, lsb * (2.0 * (timing.code_max + 1) + start) + c.k * np.abs(c.i_offset_a) / gain
