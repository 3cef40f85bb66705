# SPDX-License-Identifier: Apache-2.0
"""What a run leaves: verdict tables, figures, waves and result files."""
