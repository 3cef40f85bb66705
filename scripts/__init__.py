# SPDX-License-Identifier: Apache-2.0
"""Programs that the make targets of the chip run: generate, lint, prove, synthesize,
characterise.
"""
