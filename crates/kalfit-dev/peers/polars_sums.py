"""polars' reading of a Parquet file of `test`, `x` and `y`, and each test's sums: what any fit of a regression has to do at least."""

import os
import sys

os.environ["POLARS_MAX_THREADS"] = "1"

import common

try:
    import polars as pl
except ImportError:
    common.missing()

x, y = pl.col("x"), pl.col("y")
SUMS = [pl.len().alias("n"), x.sum(), y.sum(), (x * x).sum().alias("xx"), (x * y).sum().alias("xy"), (y * y).sum().alias("yy")]


def sums():
    return pl.read_parquet(sys.argv[1]).group_by("test").agg(SUMS)


table, run = common.repeated(sums)
common.say("polars", run, table["yy"].sum())
