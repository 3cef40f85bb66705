# SPDX-License-Identifier: Apache-2.0
"""Synthesis of rtl/: mapping, proof of equivalence, static timing."""
