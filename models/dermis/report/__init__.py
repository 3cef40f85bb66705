# SPDX-License-Identifier: Apache-2.0
"""Results of a run: verdict tables, figures, waves and files."""
