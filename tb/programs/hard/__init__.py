# SPDX-License-Identifier: Apache-2.0
"""Hard inputs, each with an exact answer, in every engine that can express them."""
