# SPDX-License-Identifier: Apache-2.0
"""Parquet, as pandas, polars and pyarrow write it: a table whose columns have names."""

import dataclasses
import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from dermis.decode.recording_text import Layout, Table, is_time
from dermis.errors import InputError, optional
from dermis.ndarrays import Floats


class Columns(Table):
    """The columns of a Parquet file; structures and lists are columns of their own, as a.b and a[0][1]."""

    def __init__(self, path: Path, data: bytes, layout: Layout) -> None:
        table = optional("pyarrow.parquet", "recordings").read_table(io.BytesIO(data))
        types = optional("pyarrow.types", "recordings")
        while any(types.is_struct(kind) for kind in table.schema.types):
            table = table.flatten()
        self.path, self.layout, self.count = path, layout, table.num_rows
        self.head, self.label, self.block = [], {}, np.zeros(self.count, int)
        columns: dict[str, Any] = {}
        for name, column in zip(table.column_names, table.columns, strict=True):
            kind = column.type
            if types.is_list(kind) or types.is_large_list(kind) or types.is_fixed_size_list(kind):
                columns |= self._parts(name, column.to_pylist())
            elif types.is_timestamp(kind) or types.is_duration(kind):
                said = f"{name if is_time(name) else f'time {name}'} [{kind.unit}]"
                columns[said] = column.cast("int64").to_numpy()
                if layout.time_key == name:
                    self.layout = dataclasses.replace(layout, time_key=said)
            elif types.is_dictionary(kind) or types.is_string(kind) or types.is_large_string(kind):
                columns[name] = [cell or "" for cell in column.to_pylist()]
            elif types.is_decimal(kind):
                columns[name] = column.cast("float64").to_numpy()
            else:
                columns[name] = column.to_numpy()
        if not self.count or not columns:
            raise InputError(path, "rows", self.count, "at least one row of numbers")
        self.names, self.width = list(columns), len(columns)
        self.columns = list(columns.values())
        lines = [*range(min(self.count, 20)), self.count - 1]
        self.sample = [[str(column[n]) for column in self.columns] for n in lines]

    def _parts(self, name: str, lists: list[Any]) -> dict[str, Floats]:
        shape = np.shape(next((one for one in lists if one is not None), []))
        try:
            array = np.array([np.full(shape, np.nan) if one is None else one for one in lists], dtype=float)
        except (TypeError, ValueError):
            raise InputError(self.path, name, "lists", "numbers, as many in every row") from None
        places = np.ndindex(*shape)
        return {name + "".join(f"[{i}]" for i in at): array[(slice(None), *at)] for at in places}

    def _column(self, k: int) -> list[str]:
        return [str(cell) for cell in self.columns[k]]

    def _parsed(self, columns: Sequence[int], keys: list[int]) -> tuple[Floats, list[list[str]]]:
        table = np.empty((self.count, len(columns)))
        for n, k in enumerate(columns):
            cells = self.columns[k]
            text = isinstance(cells, list)
            table[:, n] = self._numbers(cells, [k] * self.count, "a row") if text else cells
        return table, [list(row) for row in zip(*(self._column(k) for k in keys), strict=True)]
