# SPDX-License-Identifier: Apache-2.0
"""python -m dermis"""

from dermis.cli import main

main()
