# SPDX-License-Identifier: Apache-2.0
"""From codes back to resistance and force."""
