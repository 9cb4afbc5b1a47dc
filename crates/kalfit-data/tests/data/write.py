"""Writes the files of this folder, each with the table of `formats.rs`, by other programs than arrow-rs.

Run in this folder with pyarrow 26.0.1 and polars 2.1.0.
"""

import polars as pl
import pyarrow as pa
import pyarrow.feather as feather
import pyarrow.ipc as ipc
import pyarrow.parquet as pq

table = pa.table(
    {
        "unit": ["007", "007", "007", "7", "7", 'a, "b"', 'a, "b"'],
        "t": [0.0, 0.5, 0.5, -1.0, 2.0, 0.1, 0.2],
        "unused": [["x"], [], None, [], [], [], []],
        "n": pa.array([1, None, -3, 4, 5, 6, 7], pa.int16()),
        "y": [0.1, 1e300, None, -0.0, 5e-324, None, 1 / 3],
        "lot": pa.array(["B", "B", "A", None, "µ", "A", "B"]).dictionary_encode(),
    }
)
pq.write_table(table, "pyarrow.parquet", row_group_size=3)
pq.write_table(table, "pyarrow_v2.parquet", data_page_version="2.0", compression="zstd", use_dictionary=False)
feather.write_feather(table, "pyarrow.feather")
with ipc.new_stream("pyarrow.arrows", table.schema) as writer:
    writer.write_table(table, max_chunksize=2)

frame = pl.from_arrow(table.drop(["unused"]))
frame.write_parquet("polars.parquet")
frame.write_ipc("polars.arrow", compression="zstd")
frame.write_ipc_stream("polars.arrows")
frame.write_csv("polars.csv")
