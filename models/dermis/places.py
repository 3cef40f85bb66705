# SPDX-License-Identifier: Apache-2.0
"""Directories: the data that the package reads, and the output of its commands."""

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent

_CHECKOUT = PACKAGE.parents[1]

INSTALLED = not (PACKAGE.parent.name == "models" and (_CHECKOUT / "models" / "design.toml").is_file())
"""True for a package from a wheel; False for one that runs from a checkout of the project."""

ROOT = PACKAGE / "_data" if INSTALLED else _CHECKOUT
"""Root of models/, rtl/ and spice/: the checkout, or the copy that a wheel brings (pyproject.toml lists it)."""

BUILD = Path.cwd() / "build" if INSTALLED else ROOT / "build"
"""Output of commands that name no other place, and what is compiled once: build/ of the checkout,
or of the directory in which an installed package is imported."""
