"""A report on one target, piece by piece, on one core."""

from functools import cache

from pytest_benchmark.fixture import BenchmarkFixture

from planeopt.example import example_folder, example_targets
from planeopt.report.build import Report, assemble
from planeopt.report.examine import Examined, Options, examine
from planeopt.report.record import Provenance
from planeopt.rig import Rig, load_rig

GROUP = "A report on one target, one core"
CAME = Provenance(versions={}, rig_file="-", rig_sha256="-", command="-", seed=0, time="2026-01-01T00:00:00Z")


@cache
def rig() -> Rig:
    return load_rig(example_folder() / "truth_rig.toml")


def examined(draws: int | None) -> Examined:
    return examine(example_targets()[5], rig(), Options(draws=draws))


@cache
def report() -> Report:
    return assemble([examined(200)], rig(), CAME, Options(draws=200))


def test_all_of_one_target(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = GROUP, "spot, plane, 2,000 draws, comparison, figures"
    assert benchmark.pedantic(examined, args=(2000,), rounds=3, warmup_rounds=1).record.posterior is not None


def test_without_a_posterior(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = GROUP, "the same without the posterior"
    assert benchmark.pedantic(examined, args=(None,), rounds=3, warmup_rounds=1).record.status == "ok"


def test_its_page(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = GROUP, "the page as HTML"
    made = report()
    assert len(benchmark(lambda: made.html)) > 1e5


def test_its_paper(benchmark: BenchmarkFixture) -> None:
    benchmark.group, benchmark.extra_info["what"] = GROUP, "the page as PDF"
    made = report()
    assert len(benchmark(lambda: made.pdf)) > 1e5
