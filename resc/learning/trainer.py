"""A training run batch by batch: collect, learn, ease or harden what is flown next."""

from collections.abc import Sequence

from tensordict import TensorDict

from resc import ranks
from resc.envs.quadrotor import QuadrotorEnv
from resc.envs.torchrl_face import require_untransformed
from resc.errors import NumericalError
from resc.flying.collector import Collector
from resc.flying.diagnosis import largest_reward
from resc.flying.episodes import EpisodeStatistics
from resc.learning.algorithm import Algorithm
from resc.learning.curriculum import Curricula
from resc.policies.policy import Policy
from resc.term import Curriculum


class Trainer:
    """Trains an algorithm on the environment, one batch per `iterate`.

    Args:
        env: The batch of environments; reset on construction.
        algorithm: What learns.
        renew_scenes: Scenes of the pool to renew after each batch.
        curricula: What sets the difficulties that the environment reads.
    """

    def __init__(
        self,
        env: QuadrotorEnv,
        algorithm: Algorithm,
        *,
        renew_scenes: int = 0,
        curricula: Sequence[Curriculum] = (),
    ) -> None:
        require_untransformed(env)
        self.env = env
        self.algorithm = algorithm
        self.curricula = Curricula(curricula, env)
        self.collector = Collector(
            env,
            algorithm.policy,
            algorithm.explore,
            steps=algorithm.steps,
            renew_scenes=renew_scenes,
        )
        self.trained_s = 0.0  # in all processes that trained it
        self.made_with = ""  # fingerprint of the configuration, for checkpoints

    @property
    def policy(self) -> Policy:
        """What is trained."""
        return self.algorithm.policy

    @property
    def batch(self) -> TensorDict:
        """The batch flown last."""
        return self.collector.batch

    @property
    def statistics(self) -> EpisodeStatistics:
        """How episodes ended."""
        return self.collector.statistics

    @property
    def frames(self) -> int:
        """Environment steps learned from."""
        return self.algorithm.frames

    @property
    def batch_frames(self) -> int:
        """Environment steps per batch, of all ranks."""
        return self.collector.frames * ranks.count()

    def iterate(self) -> dict[str, float]:
        """Collects one batch and learns from it; returns the figures to log.

        Raises:
            NumericalError: Something flown, or the loss, is not finite.
        """
        batch = self.collector.collect()
        try:
            figures = self.algorithm.update(batch)
        except NumericalError as error:
            raise NumericalError(
                f"{error}, although everything flown was finite, with "
                f"{largest_reward(batch, self.env.stages)}; lower algorithm.learning_rate or "
                "algorithm.reward_scale."
            ) from None
        self.algorithm.frames += self.batch_frames
        self.statistics.exchange()
        self.curricula.advance(self.algorithm.share_trained, self.statistics.complete())
        return figures
