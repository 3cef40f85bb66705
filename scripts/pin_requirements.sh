#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Rewrites requirements.txt, requirements_base.txt and requirements_bare.txt: the newest versions that pyproject.toml
# allows, as found in a clean environment.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
"${DERMIS_PYTHON:-python3}" -m venv "$scratch/venv"
"$scratch/venv/bin/python" - >"$scratch/wanted.txt" <<'PYTHON'
import tomllib

with open("pyproject.toml", "rb") as file:
    project = tomllib.load(file)["project"]
extras = project["optional-dependencies"]
names = project["dependencies"] + [name for extra in extras if extra not in ("bare", "demo", "fpga") for name in extras[extra]]
print("\n".join(name for name in names if not name.startswith("dermis[")))
PYTHON
"$scratch/venv/bin/python" -m pip install --quiet --only-binary :all: -r "$scratch/wanted.txt"
{
    echo "# SPDX-License-Identifier: Apache-2.0"
    echo "# Every Python package of .venv, pinned; made by scripts/pin_requirements.sh from the names in pyproject.toml."
    "$scratch/venv/bin/python" -m pip freeze
} >"$scratch/requirements.txt"
# What comes without its dependencies stands in a list of its own.
"$scratch/venv/bin/python" - >"$scratch/bare.txt" <<'PYTHON'
import tomllib

with open("pyproject.toml", "rb") as file:
    print("\n".join(tomllib.load(file)["project"]["optional-dependencies"]["bare"]))
PYTHON
"$scratch/venv/bin/python" -m pip install --quiet --only-binary :all: --no-deps -r "$scratch/bare.txt"
{
    echo "# SPDX-License-Identifier: Apache-2.0"
    echo "# What is installed with --no-deps, pinned; made by scripts/pin_requirements.sh as well."
    "$scratch/venv/bin/python" -m pip freeze | grep -vxFf "$scratch/requirements.txt"
} >"$scratch/requirements_bare.txt"
# The part that `make sim` and its like use: the same versions.
"${DERMIS_PYTHON:-python3}" -m venv "$scratch/base"
"$scratch/base/bin/python" - >"$scratch/wanted_base.txt" <<'PYTHON'
import tomllib

with open("pyproject.toml", "rb") as file:
    project = tomllib.load(file)["project"]
print("\n".join([*project["dependencies"], *project["optional-dependencies"]["chip"], "hatchling"]))
PYTHON
"$scratch/base/bin/python" -m pip install --quiet --only-binary :all: -c "$scratch/requirements.txt" \
    -r "$scratch/wanted_base.txt"
{
    echo "# SPDX-License-Identifier: Apache-2.0"
    echo "# The part of requirements.txt that make sim, run, read and plan use; made by scripts/pin_requirements.sh too."
    "$scratch/base/bin/python" -m pip freeze
} >"$scratch/requirements_base.txt"
cp "$scratch/requirements.txt" "$scratch/requirements_base.txt" "$scratch/requirements_bare.txt" .
