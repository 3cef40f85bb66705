# SPDX-License-Identifier: Apache-2.0
"""The chip in transistors against the models that stand for it: extraction, closed loops, seeded faults."""
