# SPDX-License-Identifier: Apache-2.0
"""One world through the laws: passed, refused by a typed error, or broken, with the law and what it said."""

from __future__ import annotations

import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dermis.errors import InputError, SimulatorError
from tb.programs.campaign import laws
from tb.programs.campaign.world import World


@dataclass(frozen=True)
class Broken:
    """A law and one line on how it broke."""

    law: str
    what: str


@dataclass
class Outcome:
    """What became of a world.

    `refused` is the message of an InputError of the scene itself, or of the SimulatorError with which an array solve
    gave it up (exit 3); `asked` counts how often each law was asked, `compared` how
    often it had something to compare.
    """

    refused: str = ""
    given_up: bool = False
    broken: list[Broken] = field(default_factory=list)
    asked: Counter[str] = field(default_factory=Counter)
    compared: Counter[str] = field(default_factory=Counter)
    conversions: int = 0


def run(
    world: World, engines: str, seed: int, only: Iterable[str] | None = None, scratch: Path | None = None
) -> Outcome:
    """Ask the laws of `engines` (those of `only`, each without chance) about a world; its files go into `scratch`.

    Floating-point operations that are invalid, divide by zero or overflow count as defects, as do warnings and every
    exception that is none of the project's own.
    """
    if scratch is None:
        with tempfile.TemporaryDirectory() as directory:
            return run(world, engines, seed, only, Path(directory))
    outcome = Outcome()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with np.errstate(divide="raise", over="raise", invalid="raise", under="ignore"):
            subject = _subject(world, scratch, seed, outcome, laws.WHOLE[engines])
            if subject is None:
                return outcome
            outcome.conversions = subject.result.codes.size
            chance = np.random.default_rng([seed, 1])
            for name, (law, share) in laws.ENGINES[engines].items():
                asked = chance.random() < share if only is None else name in only
                if not asked:
                    continue
                outcome.asked[name] += 1
                try:
                    said = list(law(subject))
                    outcome.compared[name] += laws.COMPARED in said
                    outcome.broken += [Broken(name, what) for what in said if what != laws.COMPARED]
                except InputError:
                    pass  # what the law runs beside the scene may be beyond what an engine takes
                except SimulatorError as error:
                    if engines != "closed,event":  # there it is the Verilog or ngspice that failed
                        outcome.broken.append(Broken(name, f"exit 3: {error}"))
                except Exception as error:  # any other is what is looked for: it becomes a finding
                    outcome.broken.append(Broken(name, _told(error)))
    return outcome


def _subject(world: World, directory: Path, seed: int, outcome: Outcome, engine: str) -> laws.Subject | None:
    try:
        subject = laws.Subject(world, directory, seed, engine)
        _ = subject.result
    except InputError as error:
        outcome.refused = str(error).replace(str(directory), "")
    except SimulatorError as error:
        outcome.refused, outcome.given_up = str(error), True
    except Exception as error:  # as above
        outcome.broken.append(Broken("typed_errors", _told(error)))
    else:
        return subject
    return None


def _told(error: Exception) -> str:
    where = traceback.extract_tb(error.__traceback__)
    own = [f"{Path(f.filename).name}:{f.lineno}" for f in where if "dermis" in f.filename]
    return f"{type(error).__name__}: {error} ({' '.join(own[-2:])})"
