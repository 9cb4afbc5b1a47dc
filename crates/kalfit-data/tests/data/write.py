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


def hostile() -> None:
    """Texts that are no UTF-8, a zone that nobody knows, and encryption of a column and of everything."""
    import base64

    import pyarrow as pa
    import pyarrow.parquet as pq
    import pyarrow.parquet.encryption as encryption

    raw = pa.array([b"a", b"a", b"\xff\xfe", b"b"], type=pa.binary())
    broken = pa.Array.from_buffers(pa.string(), 4, raw.buffers())
    y = [1.0, 2.0, 3.0, 2.0]
    pq.write_table(pa.table({"id": broken, "y": y}), "broken_utf8.parquet", use_dictionary=False)
    times = pa.array([0, 1000, 2000, 3000], type=pa.timestamp("ms", tz="Mars/Olympus"))
    pq.write_table(pa.table({"id": list("aabb"), "t": times, "y": y}), "unknown_zone.parquet")

    class Keys(encryption.KmsClient):
        def __init__(self, _: object) -> None:
            super().__init__()

        def wrap_key(self, key: bytes, _: str) -> bytes:
            return base64.b64encode(key)

        def unwrap_key(self, wrapped: bytes, _: str) -> bytes:
            return base64.b64decode(wrapped)

    table = pa.table({"id": list("aabb"), "y": y})
    for name, is_plain in [("encrypted_column.parquet", True), ("encrypted_footer.parquet", False)]:
        how = encryption.EncryptionConfiguration(footer_key="f", column_keys={"k": ["y"]}, plaintext_footer=is_plain)
        factory = encryption.CryptoFactory(Keys)
        properties = factory.file_encryption_properties(encryption.KmsConnectionConfig(), how)
        with pq.ParquetWriter(name, table.schema, encryption_properties=properties) as writer:
            writer.write_table(table)


hostile()
