# SPDX-License-Identifier: Apache-2.0
"""The figures of decoding: codes to newtons, against truth."""
