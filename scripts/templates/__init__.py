# SPDX-License-Identifier: Apache-2.0
"""Templates of generated files and of the tools' scripts (Jinja)."""

from collections.abc import Iterable
from pathlib import Path

import jinja2

from dermis.chip.spice_text import spice_number

LICENSE = "SPDX-License-Identifier: Apache-2.0"
_JINJA = jinja2.Environment(
    loader=jinja2.FileSystemLoader(Path(__file__).parent),
    undefined=jinja2.StrictUndefined,
    trim_blocks=True,
    lstrip_blocks=True,
    keep_trailing_newline=True,
)
_JINJA.filters["spice"] = spice_number


def path(name: str) -> Path:
    return Path(__file__).parent / f"{name}.in"


def text(name: str, **given: object) -> str:
    return _JINJA.get_template(f"{name}.in").render(given, license=LICENSE)


def rendered(page: str, **given: object) -> str:
    return _JINJA.from_string(page).render(given)


def filled(paths: Iterable[str], **given: object) -> dict[str, str]:
    """Return the text of each path, from the template of its name."""
    return {path: text(Path(path).name, **given) for path in paths}
