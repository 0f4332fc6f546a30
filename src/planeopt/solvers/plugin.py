"""CasADi's ``nlpsol``, built once per model, plug-in and options, and driven through the stages of a programme."""

import logging
import threading
import time
from typing import Any
from weakref import WeakKeyDictionary

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from planeopt.nlp import Model, Nlp
from planeopt.solution import Effort, Trace
from planeopt.solvers import kkt
from planeopt.solvers.base import NO_TRACE, Found, functions, path_trace, too_many_equalities

Array = NDArray[np.float64]
Options = tuple[tuple[str, Any], ...]

_log = logging.getLogger(__name__)

# A CasADi solver keeps its memory and its statistics in itself: two threads in one crash the process. Nothing is lost
# by taking turns, since MUMPS serialises anyway; parallel solving means processes.
_one_at_a_time = threading.Lock()
_built: WeakKeyDictionary[Model, dict[tuple[str, Options], ca.Function]] = WeakKeyDictionary()


class Recorder(ca.Callback):
    """Keeps every iterate, in the search's unknowns.

    It does no work that could fail: CasADi swallows exceptions raised in a callback.
    """

    def __init__(self, model: Model) -> None:
        ca.Callback.__init__(self)
        n = len(model.variables)
        self._shapes = {"x": n, "g": len(model.rows), "p": model.p.shape[0] + n}
        self.iterates: list[Array] = []
        self.construct("recorder", {})

    def get_n_in(self) -> int:
        return ca.nlpsol_n_out()

    def get_n_out(self) -> int:
        return 1

    def get_sparsity_in(self, i: int) -> ca.Sparsity:
        name = ca.nlpsol_out(i)
        return ca.Sparsity.dense(1 if name == "f" else self._shapes[name.removeprefix("lam_")], 1)

    def eval(self, arg: Any) -> list[int]:
        self.iterates.append(np.asarray(arg[0]).ravel())
        return [0]


EXPANDED = 300
"""Most unknowns for which a mapped programme is expanded to scalar operations: it then solves twice as fast, but
takes a time to build that a single solve of a large one does not win back."""


def compiled(model: Model, plugin: str, options: Options) -> ca.Function:
    """Return the solver function of a model, built at the first call and kept as long as the model lives."""
    cache = _built.setdefault(model, {})
    key = (plugin, options)
    if key not in cache:
        cache[key] = _build(model, plugin, options, {})
    return cache[key]


def _build(model: Model, plugin: str, options: Options, more: dict[str, Any]) -> ca.Function:
    # The unknowns of the search are the programme's over their typical sizes, which are parameters: the same for every
    # solver of a programme, whatever it thinks of scaling.
    unknowns, sizes = (type(model.x).sym(name, model.x.shape[0]) for name in ("unknowns", "sizes"))
    f, g = ca.substitute([model.objective, model.constraints], [model.x], [unknowns * sizes])
    programme = {"x": unknowns, "p": ca.vertcat(model.p, sizes), "f": f, "g": g}
    expand = model.x.shape[0] <= EXPANDED
    quiet = {"print_time": False, "show_eval_warnings": False}
    return ca.nlpsol("solver", plugin, programme, {**quiet, **dict(options), "expand": expand, **more})


def prepare(nlp: Nlp, plugin: str, options: Options) -> None:
    """Make the solver function and those that check its answer, unless it would refuse."""
    if too_many_equalities(nlp) is None:
        functions(nlp.model)
        compiled(nlp.model, plugin, options)


def run(nlp: Nlp, plugin: str, options: Options, *, record: bool) -> Found:
    """Solve the stages of a programme one after another, each from the last one's answer; one thread at a time."""
    with _one_at_a_time:
        return _run(nlp, plugin, options, record=record)


def _run(nlp: Nlp, plugin: str, options: Options, *, record: bool) -> Found:
    refusal = too_many_equalities(nlp)
    if refusal is not None:
        return Found(nlp, nlp.start, "not called", kkt.check(nlp, nlp.start), Effort(), NO_TRACE, refusal)
    begun = time.perf_counter()
    recorder = Recorder(nlp.model) if record else None
    prepare(nlp, plugin, options)
    if recorder is None:
        solver = compiled(nlp.model, plugin, options)
    else:
        solver = _build(nlp.model, plugin, options, {"iteration_callback": recorder})
    built = time.perf_counter() - begun
    x, effort, traces, reports = nlp.start, Effort(build_s=built), [], []
    size = nlp.x_scale
    lower, upper = nlp.lower / size, nlp.upper / size
    g_lower, g_upper = nlp.row_bounds
    for stage, parameters in enumerate(nlp.stages):
        begun = time.perf_counter()
        seen = len(recorder.iterates) if recorder else 0
        known = np.concatenate([parameters, size])
        result = solver(x0=x / size, p=known, lbx=lower, ubx=upper, lbg=g_lower, ubg=g_upper)
        stats = solver.stats()
        spent = time.perf_counter() - begun
        end = np.asarray(result["x"]).ravel() * size
        x = end if np.isfinite(end).all() else x
        reports.append(str(stats["return_status"]))
        effort += _effort(stats, spent)
        iterates = [iterate * size for iterate in recorder.iterates[seen:]] if recorder else None
        traces.append(_trace(nlp, parameters, stats, stage, iterates))
        _log.debug("%s %s stage %d: %s", plugin, nlp.model.name, stage, reports[-1])
    begun = time.perf_counter()
    x, found, steps = kkt.polish(nlp, x)
    effort += Effort(steps, steps, steps, steps, solve_s=time.perf_counter() - begun)
    return Found(nlp, x, " then ".join(reports), found, effort, _joined(traces))


def _effort(stats: dict[str, Any], seconds: float) -> Effort:
    """Calls by kind; IPOPT asks for objective and rows apart at each point, `sqpmethod` together."""
    calls = {name.removeprefix("n_call_nlp_"): int(n) for name, n in stats.items() if name.startswith("n_call_nlp_")}
    values = max(calls.get("f", 0), calls.get("g", 0)) + calls.get("fg", 0)
    first = max(calls.get("grad_f", 0), calls.get("jac_g", 0)) + calls.get("jac_fg", 0)
    return Effort(int(stats.get("iter_count", 0)), values, first, calls.get("hess_l", 0), 0.0, seconds)


def _trace(nlp: Nlp, parameters: Array, stats: dict[str, Any], stage: int, iterates: list[Array] | None) -> Trace:
    """What the plug-in reports of its iterations; where the iterates were recorded, evaluated again from them."""
    if iterates is not None:
        return path_trace(nlp, parameters, np.array(iterates), np.full(len(iterates), stage), keep=True)
    iterations = stats.get("iterations", {})
    objective = np.asarray(iterations.get("obj", []), dtype=float)
    infeasibility = np.asarray(iterations.get("inf_pr", []), dtype=float)
    return Trace(objective, infeasibility, np.full(len(objective), stage))


def _joined(traces: list[Trace]) -> Trace:
    paths = [t.x for t in traces if t.x is not None]
    return Trace(
        np.concatenate([t.objective for t in traces]),
        np.concatenate([t.infeasibility for t in traces]),
        np.concatenate([t.stage for t in traces]),
        np.concatenate(paths) if paths else None,
    )
