"""A program that a strict type checker takes as it stands; it is checked, not run."""

from pathlib import Path

import numpy as np
import polars

import kalfit
import kalfit.spark

model: kalfit.Model = kalfit.Model.load(Path("gyro.toml"))
other = kalfit.Model({"states": {"bias": {}}, "measurements": {"y": {"column": "y", "equation": "bias", "noise": 1}}})
table = polars.DataFrame({"unit": ["a"], "y": [1.0]})
fit: kalfit.Fit = kalfit.fit(model, table, method="em", set={"tau": 90}, starts=3, progress=print)
kalfit.fit("gyro.toml", ["a.csv", Path("b.parquet"), table, fit_table := kalfit.reduce(model, table, out="r.parquet") or table])
mean: float = float(fit.mean[0]) + fit.covariance.sum()
estimate: float = fit.parameters["tau"].estimate
level: kalfit.Parameter = fit.parameters["sigma", "A"]
errors: list[float | None] = fit.phases[0].mean_std_error.tolist()
reason: str | None = fit.phases[0].why_unknown("mean", "bias")
first: str = fit.tests[0].id
p_value: float | None = kalfit.test(model, table, {"mean": {"fixed": {"bias": 0}}}).p_value
words: str = kalfit.check(model, table).summary(width=100)
drawn = kalfit.simulate(model, fit, table, seed=1, tests=5)
rows: int = drawn.rows
kalfit.plan(model, fit, table, [10, 20]).to_dict()
kalfit.apply(model, table, fit, states="smoothed").summary()
filter = kalfit.export(model, fit, step=0.1, at={"temperature": 20, "unit": "A7"}, out="filter.npz", format="npz")
transition: float = float((filter.F @ filter.F.T).sum())
sheet = kalfit.datasheet(model, fit, "data.csv", at={"temperature": 20}, out="sheet.json")
times: list[float] = [point["time"] for point in sheet.allan[0]["points"]]
weights: list[float] = [one["akaike_weight"] for one in kalfit.compare([fit, "other.json"]).fits]
kalfit.compare({"one": fit, "two": Path("other.json")}, out="compared.json").summary()
ensemble = kalfit.Ensemble.from_arrays(np.zeros((3, 2, 1)), observation=[[1.0]], noise=[[0.1]])
kalfit.fit(ensemble).save("fit.json")
try:
    kalfit.fit(model, table)
except kalfit.Interrupted as interrupted:
    interrupted.fit.summary()
except (kalfit.ModelError, kalfit.DataError, kalfit.FitError) as error:
    print(error)
interval: tuple[float | None, float | None] = fit.estimates["mean[bias]"].interval95
tables: list[kalfit.Table] = [fit.tidy(), fit.glance(), fit.augment(), fit.conf_int()]
ends: list[object] = fit.phases[0].correlation_interval95.tolist()
mixed: kalfit.Fit = kalfit.lmm("y ~ x + (1 | unit)", {"unit": ["a", "b"], "x": [1.0, 2.0], "y": [1, 2]}, reml=False, weights="w")
made: kalfit.FormulaModel = kalfit.model_from_formula("y ~ x + (1 | unit)", table)
made.save("folder")
terms: dict[str, str] = made.terms
covariance: kalfit.Labelled = mixed.vcov()
variance: float = covariance["mean[x]", "mean[x]"] + float(np.asarray(covariance).sum())
mixed.update(formula="y ~ (1 | unit)", set={"sigma": 1}).conf_int(0.9, "wald").to_polars()
residuals: list[float] = (mixed.resid() + mixed.fitted("y", data=table)).tolist()
density: float = mixed.apply(table, states="filtered").log_density
told_of: kalfit.Table | None = mixed.predict("design.csv", outputs={"sum": "a + b"}, confidence=0.95).table
mixed.plot("forest").savefig("forest.png")
print(mixed.summary(100, level=0.9), mixed.tidy("broom"), mixed.augment(by="row"))


def told(step: kalfit.Step) -> None:
    share: float | None = step.share


kalfit.fit(model, table, tests=False, progress=told)
