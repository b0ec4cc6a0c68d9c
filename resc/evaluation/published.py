"""Results on the paper's maps as published: time [s], energy [m^2/s^5] (2025 paper, Table I)."""

PUBLISHED: dict[str, dict[str, tuple[float, float] | None]] = {
    "paper1_map11": {
        "RESC": (4.50, 697.11),
        "EGO-Planner": (4.64, 824.03),
        "Fast-Planner": (7.43, 176.55),
    },
    "paper2_map12": {
        "RESC": (4.48, 682.53),
        "EGO-Planner": (4.88, 497.84),
        "Fast-Planner": (6.03, 44.36),
    },
    "paper3_map13": {
        "RESC": (11.7, 1147.1),
        "EGO-Planner": None,
        "Fast-Planner": None,
    },
    "paper4_map15": {
        "RESC": (4.00, 611.52),
        "EGO-Planner": (4.24, 578.94),
        "Fast-Planner": (5.33, 151.81),
    },
}
"""By scene and planner; None is a published failure."""

PLANNERS = ("RESC", "EGO-Planner", "Fast-Planner")
