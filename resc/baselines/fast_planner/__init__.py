"""Fast-Planner (Zhou, Gao, Wang, Liu and Shen, 2019): a search, a spline and a gradient descent."""

from resc.baselines.fast_planner.fitting import Fitting
from resc.baselines.fast_planner.optimisation import Optimisation
from resc.baselines.fast_planner.planner import FastPlanner
from resc.baselines.fast_planner.search import KinodynamicSearch
from resc.baselines.fast_planner.time_adjustment import TimeAdjustment

__all__ = ["FastPlanner", "Fitting", "KinodynamicSearch", "Optimisation", "TimeAdjustment"]
