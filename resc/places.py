"""Where RESC's own files are: beside the package in a checkout, within it after a wheel."""

from pathlib import Path

PACKAGE = Path(__file__).parent
SHIPPED = PACKAGE / "shipped"
"""What a wheel holds beside the code, laid out as in the repository (setup.py copies it)."""
INSTALLED = SHIPPED.is_dir()
"""Whether this is RESC from a wheel, without a repository around it."""
HOME = SHIPPED if INSTALLED else PACKAGE.parent
CONF = HOME / "conf"
RESULTS = HOME / "docs" / "results"
"""Stored references and stored runs to compare with."""
TRAIN, EVALUATE = HOME / "train.py", HOME / "evaluate.py"
