"""The table of active terms: what is observed, rewarded and ended, and what each term says."""

import json
import re
from pathlib import Path
from textwrap import shorten

from resc.envs.stages import Stages
from resc.run_folder import TERMS, replacing

ABBREVIATIONS = ("eq", "eqs", "fig", "e.g", "i.e", "cf", "vs", "approx", "ref", "sec")
"""Before a full stop that ends no sentence."""
LONGEST_SENTENCE = 100

Tables = dict[str, list[list[str]]]


def terms_of(stages: Stages) -> Tables:
    """Rows of every kind of term, each with the term's name first.

    Of an observation its first and last column and what they are, of a reward its weight, of a
    termination what it means, of a difficulty what it eases.
    """
    terms = stages.terms
    observed, first = [], 0
    for term in terms.observations:
        steps = f" x {term.history} steps" if term.width > len(term.columns) else ""
        columns = f"{', '.join(term.columns)}{steps}"
        observed.append([term.name, str(first), str(first + term.width - 1), columns])
        first += term.width
    ends = [
        [term.name, "success" if term.success else "truncates" if term.truncates else "failure"]
        for term in terms.terminations
    ]
    tables = {
        "observation": observed,
        "reward": [[t.name, f"{t.weight:g}", first_sentence(t)] for t in terms.rewards],
        "termination": [
            [*end, first_sentence(t)] for end, t in zip(ends, terms.terminations, strict=True)
        ],
        "randomization": [[t.name, first_sentence(t)] for t in terms.randomizations],
        "difficulty": [
            [name, ", ".join(path for path, by in stages.eased.items() if by == name)]
            for name in stages.difficulties
        ],
    }
    return {kind: rows for kind, rows in tables.items() if rows or kind in _ALWAYS}


def write_terms(stages: Stages, folder: Path) -> None:
    """Leaves the rows in a folder."""
    with replacing(folder / TERMS) as part:
        part.write_text(json.dumps(terms_of(stages), indent=1) + "\n")


def describe(stages: Stages) -> str:
    """The table as text."""
    lines = []
    for kind, rows in terms_of(stages).items():
        lines.append(f"{kind:<22} {_HEADS.get(kind, '')}".rstrip())
        for name, *cells in rows:
            lines.append(f"  {name:<20} {_LAYOUTS.get(kind, '{}').format(*cells)}")
    return "\n".join(lines)


def first_sentence(term: object) -> str:
    """The first sentence of a term's docstring."""
    text = " ".join((type(term).__doc__ or "").split())
    text = re.sub(r" \(facts [\d., ab]+\)", "", text)  # sections of the sheet of public facts
    ends = [found.start() for found in re.finditer(r"\.(?= |$)", text)]
    ends = [end for end in ends if not text[:end].lower().endswith(ABBREVIATIONS)]
    return shorten(text[: ends[0]] if ends else text, LONGEST_SENTENCE, placeholder=" ...")


_ALWAYS = ("observation", "reward", "termination")
_HEADS = {"observation": "columns", "reward": "weight", "difficulty": "eases"}
_LAYOUTS = {"observation": "{:>3}-{:<3} {}", "reward": "{:>7} {}", "termination": "{:<9} {}"}
