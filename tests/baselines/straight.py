"""A planner for tests: a quintic from rest to rest straight to the goal, whatever is in between."""

import numpy as np

from resc.baselines.planner import Plan, Planner, State, at_rest

NORMALISED = np.array([0, 0, 0, 10.0, -15.0, 6.0])
"""Share of the way over the share of the time, in ascending powers."""


class Straight(Planner):
    def __init__(self, duration_s=5.0):
        self.duration_s = duration_s

    def begin(self, obstacles, start_w, goal_w):
        self.start, self.way = start_w, goal_w - start_w
        self.plans, self.finished = [], False

    def tick(self, time_s, odometry):
        if not self.plans:
            self.plans.append(Plan(time_s, 0.001))
        self.finished = time_s >= self.duration_s

    def commanded(self, time_s):
        if not self.plans:
            return at_rest(self.start)
        if time_s >= self.duration_s:
            return at_rest(self.start + self.way)
        share, polynomial = time_s / self.duration_s, NORMALISED
        values = []
        for order in range(4):
            value = np.polynomial.polynomial.polyval(share, polynomial)
            values.append(value / self.duration_s**order * self.way)
            polynomial = np.polynomial.polynomial.polyder(polynomial)
        return State(self.start + values[0], *values[1:])
