"""Every command and every program that README and docs show runs, its budget cut.

The fast half says by which rule each is run and reads it; the slow half runs it in a folder of its
own, beside runs made in the same way.
"""

import json
import multiprocessing
import re
import shlex
import shutil
import tomllib
from importlib.util import find_spec
from multiprocessing import forkserver
from pathlib import Path

import pytest
import yaml
from hydra.core.override_parser.overrides_parser import OverridesParser
from shown import ROOT, blocks, commands, is_shell
from shown_started import started

from resc.log_command import build_parser
from resc.starting.arguments import quoted_paths

TRAIN = (
    *("compile=false", "num_envs=8", "total_frames=512", "pool_size=8", "renew_scenes=0"),
    *("algorithm.steps=32", "algorithm.minibatch=64", "evaluation_episodes=4", "logger=csv"),
    "termination.time_limit.limit_s=1.0",
)
EVALUATE = ("flights=1", "compile=false", "scene_files=0", "termination.time_limit.limit_s=1.0")
RANDOM = re.compile(r"suite=\S*(?:forest|field|dynamic|gaps|rooms|corridors)")
"""Suites that draw maps, which can be fewer."""
CUTS = {
    "python train.py": TRAIN,
    "torchrun --nproc-per-node=2 train.py": TRAIN,
    "python evaluate.py": EVALUATE,
    "python -m resc.studies.scores": EVALUATE[:-1],
    "python -m resc.evaluation.transfer": (*EVALUATE, "conditions=[nominal,mass_20_percent]"),
    "python -m resc.evaluation.bound": ("references=references.json",),
    "python -m resc.deployment.export": (),
    "python -m resc.deployment.fly": ("--cfg job",),  # with a peer: tests/deployment
    "python -m resc.deployment.peer": ("--cfg job",),
    "python -m resc.evaluation.compare": (),
    "python -m resc.evaluation.rate_steps": (),
    "python -m resc.pages": (),
    "python -m resc.studies": (),
    "python -m resc.viewing.observation_picture": ("drawn",),
    "python -m resc.viewing.scene_picture": ("conf/scene/planned.yaml", "1"),
    "python -m benchmarks": ("--help",),  # they measure for minutes
    "python benchmarks": ("--help",),
    "python examples/behaviour_cloning.py": ("--updates 5 --batch 64 evaluation_episodes=4",),
    "resc-log": (),
    "g++": (),
}
"""What is added to the commands that begin so."""
BUDGET = ("num_envs", "total_frames", "maps", "flights", "compile")
"""Settings that give way to those of the cut."""
FEWER = {
    "ablate_observation": "obstacle_observation=none,kgp_esdf",
    "ablate_search": "search=exact,jps seed=0",
    "ablate_transfer": "+ingredient=nothing,masses algorithm.init_from_std=0.2",
    "best_of": "hydra.sweeper.best=1 hydra.sweeper.seeds=1",
    "tune_reward": "hydra.sweeper.trials=2",
}
"""Variants of those studies."""
NAMES = {
    r"runs/<date>/<time>_tune_reward": "runs/tuned",
    r"runs/<date>/<time>_evaluate": "runs/swept",
    r"runs/<date>/<time>_<name>": "runs/latest_sweep",
    r"runs/2025-11-22/10-00-00_train": "runs/latest_train",
    r"runs/<one> runs/<other>|runs/<evaluation> runs/<evaluation>": "runs/one runs/other",
    r"runs/<run> runs/<run>": "runs/latest_sweep/0 runs/latest_sweep/1",
    r"=E sensor.mocap.latency_s=T": "=kf_imu sensor.mocap.latency_s=0.02",
    r"sensing=S": "sensing=depth",
    r"'scenes=\[mine\]'": "'scenes=[paper4_map15]'",
    r"--episode \d+": "--episode 0",
    r"#\d+": "#0",
    r" -m policy=latest limits\.\S+ limits\.\S+": (
        " -m policy=policies/dial limits.speed_mps=2,3 limits.margin_m=0.2,0.3"
    ),
    r"obstacle_observation=kgp_esdf,ray\S+ seed=\S+": "obstacle_observation=kgp_esdf,none seed=0",
    r"device=cuda": "device=cuda --cfg job",  # trained where there is one: make gpu
    r"reward=\[progress,time,crash,height\]'": (
        r"reward=[progress,time,crash,height]' 'hydra.searchpath=[own/conf]' "
        r"'allowed_targets=[own.]'"
    ),
    r"cloning.py runs/latest_train": "cloning.py runs/latest_evaluation",  # where some succeed
    r"--into mine": "--into compared",
    r"runs/<sweep>": "runs/latest_sweep",
    r"FOLDER \.\.\.": "runs/latest_train",
}
"""What a reader puts into a command, or what the small runs have."""
TUNED = "python train.py -m +experiment=tune_reward hydra.sweep.dir=runs/tuned"
FIRST = {
    "resume=runs/latest_sweep": "python train.py -m obstacle_observation=kgp_esdf,none seed=0",
    "=2 train.py resume": "torchrun --nproc-per-node=2 train.py",
    "resume=runs/tuned": TUNED,
    "best_of": TUNED,
    "resc.studies.tuning": "python train.py -m +experiment=tune_reward",
    "resc.studies.dial": (
        "python evaluate.py -m policy=policies/dial limits.speed_mps=2,3 limits.margin_m=0.2,0.3 "
        "recorder=none hydra.sweep.dir=runs/swept"
    ),
    "compare runs/latest_evaluation": "python evaluate.py 'pilot=[policy,pursuit]'",
    "resc-log smooth": "python evaluate.py estimator=kf_imu 'scenes=[paper4_map15]'",
    "flight.mcap": "resc-log from-ulog flight.ulg",
    "g++": "python -m resc.deployment.export hydra.run.dir=exported",
    "cloning.py runs/lerobot": "resc-log lerobot runs/latest_evaluation --out runs/lerobot",
}
"""What a reader of the page has run before."""
MENTIONED = re.compile(
    r"resc-log [\w-]+$|python -m resc\.(log_command COMMAND|studies\.scores)$|resc-log COMMAND$"
    r"|resc-log identify RECORDING$|torchrun --nproc-per-node=K$"
)
"""Programs that the text speaks of: they say how they are used."""
IMPORTED = [
    "resc.learning.training_run",
    "resc.evaluation.campaign",
    "resc.pages.write",
    "resc.recording",
    "matplotlib.pyplot",
]
"""What takes seconds in every process."""
HISTORY = "docs/log.md"
"""It keeps what was once run, by commands of its time."""
OTHERWISE = {
    "make": "a target of the Makefile, which CI calls",
    "pip": "installs an extra of pyproject.toml",
    "./fly_policy": "tests/deployment/test_export.py compiles and runs it",
    "python examples/draw_map.py": "writes into the repository; draws the map of a scene",
    "python train.py scene=planned_map": "as the map of conf/scene/planned_map.yaml",
    "python -m benchmarks.planning": "measures for minutes, and has no arguments",
    "python benchmarks/link.py": "measures for minutes, and has no --help",
    "resc-log identify flight.ulg": "tests/flight_logs/test_identify.py, on the log of a flight",
    "resc-log rerun": "tests/viewing/test_rerun.py, where Rerun is installed",
    "python tests/viewing/rerun_viewer.py": "tests/viewing/test_rerun_browser.py, in a browser",
    "launcher=ray": "tests/test_scale.py, where Ray is installed",
}
"""Commands that run elsewhere, and where or why."""


def rule(line):
    """How a command is run: the beginning that `CUTS` knows, or why it is not."""
    for beginning, why in OTHERWISE.items():
        if line.startswith(beginning) or beginning in line.split():
            return why
    bare = re.sub(r"^PYTHONPATH=\S+ ", "", line)
    found = [beginning for beginning in CUTS if bare.startswith(beginning)]
    return max(found, key=len) if found else None


SHOWN = {line: pages for line, pages in commands().items() if pages != [HISTORY]}
RUN = [line for line in SHOWN if rule(line) in CUTS]


def cut(line):
    """A command as it is run here."""
    if MENTIONED.match(line):
        return re.sub(r"COMMAND|RECORDING", "", line).replace("=K", "=2") + " --help"
    for pattern, value in NAMES.items():
        line = re.sub(pattern, value, line)
    added = list(CUTS[rule(line)])
    if rule(line) == "python train.py" and ("--cfg" in line or "--info" in line):
        return line
    if "resume=" in line or "replay=" in line:
        added = []
    if "algorithm=reinforce" in line:  # its batch is whole
        added.remove("algorithm.minibatch=64")
    if RANDOM.search(line) or "suite=[" in line:
        added.append("maps=1")
    added += [fewer for study, fewer in FEWER.items() if study in line][:1]
    words = [w for w in WORD.findall(line) if not set_by(w) & {*BUDGET}]
    if "resume=" in line and "total_frames" in line:
        words.append("total_frames=1024")
    here = {name for word in words for name in set_by(word)}
    words += [a for a in added if not set_by(a) & here]
    return " ".join(words)


WORD = re.compile(r"""(?:'[^']*'|"[^"]*"|[^\s'"])+""")


def set_by(word):
    """The setting that a word of a command sets."""
    return {word.strip("'").partition("=")[0].lstrip("+~")} if "=" in word else set()


@pytest.fixture(scope="session")
def run_once():
    """`run_once(folder, line)` runs a command of a page in a folder."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(IMPORTED)
    with pytest.MonkeyPatch.context() as patch:  # a server knows no other path
        patch.setenv("PYTHONPATH", str(ROOT))
        patch.setenv("OMP_NUM_THREADS", "1")
        forkserver.ensure_running()

    def run(folder, line):
        for part in line.split(" && "):
            with (folder / "said.txt").open("w+") as said:
                target, words = started, shlex.split(part)
                process = context.Process(target=target, args=(words, str(folder), said.name))
                process.start()
                process.join(timeout=600)
                process.kill()
                process.join()
                assert process.exitcode == 0, f"{part}\n{said.read()[-4000:]}"

    return run


@pytest.fixture(scope="session")
def prepared(tmp_path_factory, run_once):
    """A folder as a reader has it who has trained, swept and evaluated, and written the files."""
    folder = tmp_path_factory.mktemp("prepared")
    for name in ("train.py", "evaluate.py", "resc", "conf", "examples", "benchmarks", "policies"):
        (folder / name).symlink_to(ROOT / name)
    (folder / "hydra_plugins").symlink_to(ROOT / "hydra_plugins")
    (folder / "tests").symlink_to(ROOT / "tests")
    (folder / "docs").mkdir()
    shutil.copy(ROOT / "tests" / "data" / "px4_sitl_iris.ulg", folder / "flight.ulg")
    write_shown(folder)
    sweep = "python train.py -m obstacle_observation=kgp_esdf,none seed=0"
    for line in (sweep, "python train.py"):
        run_once(folder, cut(line))
    for name in ("one", "other"):
        quick = "python evaluate.py scenes=paper4_map15 flights=1 scene_files=0"
        run_once(folder, f"{quick} hydra.run.dir=runs/{name}")
    return folder


def write_shown(folder):
    """The files that pages show; what they would put into the repository goes to `own`."""
    for block in blocks():
        first = re.match(r"# (\S+\.yaml)$", block.text, re.MULTILINE)
        name = block.file or (first[1] if first else "")
        if block.language not in ("python", "yaml") or not name:
            continue
        path = folder / re.sub(r"^(?:resc/.*/|(?=conf/))", "own/", name)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(re.sub(r"resc\.terms\.rewards\.(?=height)", "own.", block.text))
    for package in ("mypackage", "mypackage/conf", "own"):
        (folder / package / "__init__.py").touch()


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("line", RUN)
def test_a_command_runs(line, prepared, run_once, tmp_path):
    folder = tmp_path / "here"
    shutil.copytree(prepared, folder, symlinks=True)
    for part, before in FIRST.items():
        if part in cut(line):
            run_once(folder, cut(before))
            break
    run_once(folder, cut(line))


LISTINGS = {
    "runs/<date>/<time>_<name>/": "what a sweep leaves",
    "mypackage/": "tests/test_add_a_term.py",
    "  goal_offset           45-47  x, y, z": "tests/test_add_a_term.py",
    "predict    x <- F x + G a,  P <- F P F^T + Q": "equations",
}
"""Blocks without a language that hold no commands, by how they begin."""
PROGRAMS = {
    "README.md": "tests/test_readme.py",
    "docs/add-a-part.md": "tests/test_add_a_part.py",
    "docs/add-a-term.md": "tests/test_add_a_term.py",
    "docs/gymnasium.md": "tests/test_gym.py",
}
"""Pages whose programs another test runs; those of all others run below."""
BEFORE = {
    "docs/planning.md": """
import numpy as np
occupancy = np.zeros((100, 100), bool)
""",
}
"""What the text of a page takes for given."""
OF_RERUN = "rerun"


def test_every_block_is_of_a_known_kind():
    for block in blocks():
        known = is_shell(block) or block.language in ("python", "yaml", "json")
        assert known or any(block.text.startswith(begin) for begin in LISTINGS), block


def test_every_command_is_run_here_or_it_is_said_where():
    assert [line for line in SHOWN if not MENTIONED.match(line) and not rule(line)] == []


def test_settings_of_every_command_are_read_by_hydra():
    parser = OverridesParser.create()
    scripts = ("train.py", "evaluate.py", "resc.evaluation.transfer", "resc.deployment")
    for line in RUN:
        words = shlex.split(cut(line).replace("<", "").replace(">", ""))
        if any(word.startswith(scripts) for word in words):
            parser.parse_overrides(
                quoted_paths([w for w in words if set_by(w) and w[0] not in "P-"])
            )


def test_every_target_and_every_extra_that_is_shown_is_there():
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    for line in SHOWN:
        if line.startswith("make "):
            assert set(line.split()[1:]) <= {*targets}, line
        for extra in re.findall(r"pip install .*\[(\w+)\]", line):
            assert extra in extras, line


def test_every_command_of_resc_log_that_is_shown_is_there():
    (choices,) = (action.choices for action in build_parser()._actions if action.choices)
    named = {line.split()[1] for line in SHOWN if re.match(r"resc-log [a-z]", line)}
    assert named <= set(choices)


def test_every_file_that_is_shown_can_be_read():
    for block in blocks():
        if block.language == "yaml":
            assert yaml.safe_load(block.text), block
        elif block.language == "json":
            json.loads(block.text)
        elif block.language == "python":
            compile(block.text, f"{block.page}:{block.line}", "exec")


def test_what_runs_elsewhere_is_run_there():
    for page, test in PROGRAMS.items():
        assert Path(page).name in (ROOT / test).read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    "page", sorted({b.page for b in blocks() if b.language == "python"} - PROGRAMS.keys())
)
def test_the_programs_of_a_page_run_one_after_the_other(page, prepared, run_once, tmp_path):
    """Those of docs/recording.md read a recording at `rollouts/train`."""
    folder = tmp_path / "here"
    shutil.copytree(prepared, folder, symlinks=True)
    (folder / "rollouts").mkdir()
    (folder / "rollouts" / "train").symlink_to(folder / "runs" / "latest_train" / "rollouts")
    programs = [
        b.text for b in blocks() if b.page == page and b.language == "python" and not b.file
    ]
    text = "\n".join((BEFORE.get(page, ""), *programs)).replace("success=True, ", "")
    if not find_spec(OF_RERUN):
        text = "\n".join(line for line in text.splitlines() if OF_RERUN not in line)
    (folder / "shown.py").write_text(text)
    run_once(folder, "python shown.py")
