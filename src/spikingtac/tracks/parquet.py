"""Tracks as Parquet, in long form: a fraction of the CSV file, for pandas, Polars, R and DuckDB."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from spikingtac.atomic_files import WholeFile
from spikingtac.errors import MissingExtraError
from spikingtac.tracks.columns import CSV_COLUMNS, VECTORS, long_columns, stacked
from spikingtac.types import MarkerFrame

META_KEY = "spikingtac"
"""Key of the file's metadata that holds what CSV has beside it, as JSON."""
ROWS_PER_GROUP = 1 << 17
"""Rows that are compressed together: 2,048 frames of 64 markers, some megabytes of memory."""


class ParquetTracksWriter:
    """Writes the columns of the CSV file, with their types, at constant memory.

    Args:
        path: File to write.

    Raises:
        MissingExtraError: pyarrow is not installed.
    """

    def __init__(self, path: Path) -> None:
        try:
            import pyarrow as pa
            import pyarrow.parquet as pq
        except ImportError as error:
            raise MissingExtraError(
                "Parquet needs pyarrow; install it with: pip install 'spikingtac[parquet]'"
            ) from error
        types = {"t_us": pa.int64(), "marker": pa.int16(), "held": pa.bool_()}
        self._schema = pa.schema([(name, types.get(name, pa.float32())) for name in CSV_COLUMNS])
        self._make_table = pa.table
        self._target = WholeFile(path)
        # Neighbours in a float column share their high bytes, and hardly any value repeats.
        repeating = ["t_us", "marker"]
        floats = [name for name in CSV_COLUMNS if name not in types]
        self._file = pq.ParquetWriter(
            self._target.partial,
            self._schema,
            compression="zstd",
            use_dictionary=repeating,  # pyright: ignore[reportArgumentType] - or a list of names
            use_byte_stream_split=floats,  # pyright: ignore[reportArgumentType]
        )
        self._frames: list[MarkerFrame] = []

    def write(self, frame: MarkerFrame) -> None:
        """Append a frame."""
        self._frames.append(frame)
        if len(self._frames) * len(frame.coasted) >= ROWS_PER_GROUP:
            self._flush()

    def close(self, meta: Mapping[str, Any]) -> None:
        """Complete the file with what is known at the end; only then it appears."""
        self._flush()
        self._file.add_key_value_metadata({META_KEY: json.dumps(meta, sort_keys=True)})
        self._file.close()
        self._target.commit()

    def abandon(self) -> None:
        """Give up: leave what was there before."""
        self._file.close()
        self._target.abandon()

    def _flush(self) -> None:
        if not self._frames:
            return
        frames, self._frames = self._frames, []
        columns = stacked(frames, len(frames[0].coasted))
        vectors = {name: columns[name] for name in VECTORS}
        rows = long_columns(columns["t_us"], vectors, columns["held"], columns["confidence"])
        self._file.write_table(self._make_table(rows, schema=self._schema))
