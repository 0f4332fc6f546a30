"""The posterior of a plane: likelihood, prior, sampling with emcee, and summaries that say what they rest on.

Read `Posterior.summary`, `Posterior.cone` and `Posterior.split` for the answer, `Posterior.diagnostics` for whether the
chain was long enough, `Posterior.agreement` for whether the first-order law would have done, and
`Posterior.prior_effect` for how much of the answer is the prior's. ``docs/posterior.md`` derives all of it.
"""

from planeopt.posterior.chain import Progress
from planeopt.posterior.diagnostics import Diagnostics, Stop
from planeopt.posterior.gaussian import Laplace
from planeopt.posterior.likelihood import Likelihood, Scale
from planeopt.posterior.prior import PlanePrior, Prior
from planeopt.posterior.record import PosteriorRecord, posterior_record
from planeopt.posterior.result import Mode, Posterior, PriorEffect
from planeopt.posterior.sample import sample_posterior, sample_problem
from planeopt.posterior.summary import Cone, Interval, Split

__all__ = [
    "Cone",
    "Diagnostics",
    "Interval",
    "Laplace",
    "Likelihood",
    "Mode",
    "PlanePrior",
    "Posterior",
    "PosteriorRecord",
    "Prior",
    "PriorEffect",
    "Progress",
    "Scale",
    "Split",
    "Stop",
    "posterior_record",
    "sample_posterior",
    "sample_problem",
]
