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

# Estimates files, as `book/src/guide/exchange.md` describes them: states in another order than the model's, `tilt` first; n = 2, m = 3.
covariance = [
    [0.0, 0.0, 0.0, 0.0, 0.0],
    [0.0, 4.0, 0.5, 0.0, 1.0],
    [0.0, 0.5, 1.0, 0.0, 0.25],
    [0.0, 0.0, 0.0, 9.0, 0.0],
    [0.0, 1.0, 0.25, 0.0, 0.5],
]
row = {
    "states": ["tilt", "v"],
    "estimates": [1.0, 2.0, 3.0],
    "offsets": [0.0, 0.0, 0.5],
    "sensitivities": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0],
    "covariance": [element for line in covariance for element in line],
    "transition": [1.0, 2.0, 3.0, 4.0],
    "steps": 5,
    "observations": None,
    "lot": "A",
    "x": 1.5,
}
rows = [{"test": "007", **row}, {"test": "8", **row}]
estimates = pa.Table.from_pylist(rows)
pq.write_table(estimates, "estimates_pyarrow.parquet", row_group_size=1)
lists = {name: len(row[name]) for name in ["estimates", "offsets", "sensitivities", "covariance", "transition"]}


def as_lists(of):
    fields = [pa.field(f.name, of(f.name)) if f.name in lists else f for f in estimates.schema]
    return pa.Table.from_pylist(rows, pa.schema(fields))


pq.write_table(as_lists(lambda _: pa.large_list(pa.float64())), "estimates_large.parquet", compression="zstd")
pq.write_table(as_lists(lambda name: pa.list_(pa.float32(), lists[name])), "estimates_single.parquet")
pl.DataFrame(rows).write_parquet("estimates_polars.parquet")
