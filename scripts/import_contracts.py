# SPDX-License-Identifier: Apache-2.0
"""A contract for import-linter: no import cycle between the modules of a package, type imports included."""

from graphlib import CycleError, TopologicalSorter
from typing import Any

from importlinter import Contract, ContractCheck, fields, output


class NoCircles(Contract):
    """No import cycles between modules; the contract of import-linter checks whole folders only."""

    type_name = "no_circles"

    packages = fields.ListField(subfield=fields.StringField())

    def check(self, graph: Any, verbose: bool) -> ContractCheck:
        """Find an import cycle in each package."""
        circles = []
        for package in self.packages:
            modules = {name for name in graph.modules if name == package or name.startswith(f"{package}.")}
            imports = {name: graph.find_modules_directly_imported_by(name) & modules for name in modules}
            try:
                TopologicalSorter(imports).prepare()
            except CycleError as error:
                circles.append(error.args[1][::-1])
        return ContractCheck(kept=not circles, metadata={"circles": circles})

    def render_broken_contract(self, check: ContractCheck) -> None:
        """Print each cycle as a chain of imports."""
        for circle in check.metadata["circles"]:
            output.print_error(" -> ".join(circle))
