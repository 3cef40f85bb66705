# SPDX-License-Identifier: Apache-2.0
"""Effects in time: ripple of the bias, and forces that change within a frame."""

import math

from dermis import bounds
from dermis.effects.effect import Effect, number, positive

EFFECTS = (
    Effect(
        "supply_ripple",
        "sine on the bias of the driven row",
        {
            "relative": number(
                "Amplitude on the bias, relative", 0.05, (1e-4, 0.05), "a finite number 0..1", ge=0, le=1
            ),
            "frequency_hz": positive("Of the ripple, in Hz", 3e3, (1e3, 1e6)),
            "phase_deg": number(
                "At the first clock of the first frame, in degrees", 30.0, (1.0, 360.0), default=0.0
            ),
        },
        {"relative": "ripple.relative", "frequency_hz": "ripple.frequency_hz"},
        drive={
            "ripple": "relative",
            "f_ripple_hz": "frequency_hz",
            "phase_ripple_rad": lambda p, _: math.radians(p.phase_deg),
        },
        bound=bounds.supply_ripple,
    ),
    Effect(
        "motion",
        "forces change within frame and gate: conductances on straight lines from frame to frame",
        {},
        drive={"motion": lambda p, _: True},
        bound=bounds.motion,
        considered=False,
    ),
)
