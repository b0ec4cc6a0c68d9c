"""What estimators cost: the Kalman filters alone, and the whole step with each estimator.

python -m benchmarks.estimators
"""

import argparse
import time
from collections.abc import Callable

import torch

from resc.math.kalman import corrected, predicted_covariance, transition, white_acceleration

DT_S = 0.02
ESTIMATORS = ("none", "noise", "fd_lpf", "kf_cv", "kf_imu", "ekf")


def median_ms(work: Callable[[], object], repeats: int) -> float:
    """Median wall time of a call [ms], after ten that do not count."""
    times = []
    for number in range(repeats + 10):
        began = time.perf_counter()
        work()
        if number >= 10:
            times.append(time.perf_counter() - began)
    return 1e3 * sorted(times)[len(times) // 2]


def filter_ms(count: int, repeats: int, *, compiled: bool, shared: bool) -> float:
    """Prediction and correction of `count` x 3 axes [ms].

    Args:
        count: Environments.
        repeats: Calls.
        compiled: Whether they are compiled.
        shared: Whether the axes share one covariance, as in the estimators, or have their own.
    """
    rows, columns = (count, 3) if shared else (3 * count, 1)
    mean, covariance = torch.zeros(rows, 2, columns), torch.eye(2).expand(rows, 2, 2).clone()
    position, used = torch.randn(rows, 1, columns), torch.rand(rows, 1) > 0.1
    move, wander = transition(DT_S, mean), white_acceleration(DT_S, 0.6, mean)
    observed, noise = torch.tensor([[1.0, 0.0]]), torch.tensor([[1e-6]])

    def step(mean: torch.Tensor, covariance: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        mean, covariance = move @ mean, predicted_covariance(covariance, move, wander)
        innovation = position - observed @ mean
        return corrected(
            mean, covariance, innovation=innovation, observed=observed, noise=noise, used=used
        )

    run = torch.compile(step, fullgraph=True, dynamic=False) if compiled else step
    return median_ms(lambda: run(mean, covariance), repeats)


def step_ms(name: str, count: int, repeats: int, *, compiled: bool) -> float:
    """The whole control step of `count` environments without obstacles [ms]."""
    from resc.door import make_env

    chosen = (f"estimator={name}", "scene=free", "obstacle_observation=none")
    env = make_env(*chosen, num_envs=count, compile=compiled)
    env.restart(torch.arange(count))
    action = torch.zeros(count, 4)
    return median_ms(lambda: env.advance(action), repeats)


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--envs", type=int, default=4096)
    parser.add_argument("--repeats", type=int, default=100)
    parser.add_argument("--eager", action="store_true", help="compile nothing")
    parser.add_argument("--estimators", nargs="*", default=ESTIMATORS)
    given = parser.parse_args()
    torch.set_num_threads(1)
    with torch.no_grad():
        for shared in (True, False):
            for compiled in (False,) if given.eager else (False, True):
                took = filter_ms(given.envs, given.repeats, compiled=compiled, shared=shared)
                how = "compiled" if compiled else "eager"
                of = "one covariance" if shared else "three covariances"
                print(f"filter of {given.envs} x 3 axes, {of}, {how}: {took:.2f} ms", flush=True)
        for name in given.estimators:
            took = step_ms(name, given.envs, given.repeats, compiled=not given.eager)
            print(f"whole step, estimator={name}: {took:.2f} ms", flush=True)


if __name__ == "__main__":
    main()
