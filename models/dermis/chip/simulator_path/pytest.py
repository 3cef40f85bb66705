# SPDX-License-Identifier: Apache-2.0
"""Stands for pytest in the process of an HDL simulator, where nothing uses it.

cocotb 2.1 imports it for the exceptions of three functions, and for rewriting assertions even where that is off;
importing it takes as long as all the rest of cocotb.
"""

import sys
import types


class raises:
    class Exception(Exception): ...


class skip:
    class Exception(Exception): ...


class xfail:
    class Exception(Exception): ...


for name in ("_pytest.assertion", "_pytest.config"):
    sys.modules[name] = types.ModuleType(name)
    vars(sys.modules[name]).update(install_importhook=None, Config=None)
