# SPDX-License-Identifier: Apache-2.0
"""Effects of the charge source: errors of the packets and of the preset."""

from dermis.effects.effect import column, exact_effect, number, too_warm

EFFECTS = (
    exact_effect(
        "charge_packet",
        "relative error of every packet",
        {
            "packet_error": column(
                "Relative error of every packet; that of reference_drift is added", 0.03, (1e-4, 0.05), gt=-1
            )
        },
        {"packet_error": "charge.packet_error"},
        converter={"packet_error": "packet_error"},
    ),
    exact_effect(
        "preset_error",
        "error of the preset voltage",
        {"v_v": column("Error, in V of the integrator; plus is more charge", 0.2, (1e-4, 0.3), 1e-3)},
        converter={"preset_error_v": "v_v"},
    ),
    exact_effect(
        "reference_drift",
        "drift of the reference current, and so of every packet, with temperature",
        {
            "tc_per_k": number("Relative change of i0 a kelvin", 1e-3, (1e-5, 1e-3)),
            "delta_k": number("How far the chip is from where i0 was set, in K", 40.0, (1.0, 60.0)),
        },
        {"tc_per_k": "charge.tc_per_k", "delta_k": "ambient.delta_k"},
        converter={"packet_error": lambda p, _: p.tc_per_k * p.delta_k},
        wrong=too_warm,
    ),
)
