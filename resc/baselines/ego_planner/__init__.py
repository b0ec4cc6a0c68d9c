"""EGO-Planner, one file for each stage; `EgoPlanner` is the whole."""

from resc.baselines.ego_planner.planner import EgoPlanner

__all__ = ["EgoPlanner"]
