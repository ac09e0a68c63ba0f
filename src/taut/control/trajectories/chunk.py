"""taut.chunk: a few future samples with their times, of samples, poses or joint positions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from taut.base.checks import finite_array
from taut.base.errors import ShapeError
from taut.base.types import ArrayLike, Float64Array
from taut.control.tables import sample_times
from taut.control.trajectories.reference import Chunk, JointMotion, Sample
from taut.control.trajectories.task_blend import differences
from taut.control.trajectories.task_reference import TaskMotion
from taut.trace.pose import Pose

__all__ = ["chunk"]


def chunk(times: ArrayLike, targets: Sequence[Sample] | Sequence[Pose] | ArrayLike) -> Chunk:
    """A few future samples with their times.

    From one `taut.TaskMotion` to the next the tool moves smoothly, as a quintic of its position and of its rotation
    vector that has their twists and accelerations; a task motion without a twist is one at rest. From poses alone
    twists and accelerations follow by differences, so that two of them make a straight line with slerp.

    Args:
        times: (k,) [s] from the moment the chunk starts, increasing.
        targets: k samples, or k poses, or joint positions (k, n), whose velocities then follow from the differences.

    Raises:
        ShapeError: Not as many targets as times.
        RangeError: Times that do not increase.

    Example:
        >>> chunk([0.0, 0.1], [[0.0], [1.0]]).at(0.05).q.tolist()
        [0.5]
        >>> ahead = chunk([0.0, 0.1], [Pose([0.4, 0.0, 0.3]), Pose([0.4, 0.02, 0.3], rpy=[0.0, 0.0, 0.2])])
        >>> ahead.at(0.05).pose.rpy.round(6).tolist(), ahead.at(0.05).twist.round(6).tolist()
        ([0.0, 0.0, 0.1], [0.0, 0.2, 0.0, 0.0, 0.0, 2.0])
    """
    t = sample_times(times)
    kinds = {type(target) for target in targets} if isinstance(targets, Sequence) else set()
    if kinds and all(issubclass(kind, Sample) for kind in kinds):
        samples: tuple[Sample, ...] = tuple(targets)  # type: ignore[arg-type]  # checked in the line above
    elif kinds == {Pose}:
        samples = _through_poses(t, targets)  # type: ignore[arg-type]  # checked in the line above
    else:
        q = finite_array("targets", targets, unit="rad | m")  # type: ignore[arg-type]  # checked inside
        if q.ndim != 2:
            raise ShapeError(f"targets must have shape (k, n); got {q.shape}", name="targets")
        v = np.gradient(q, t, axis=0) if len(t) > 1 and len(q) == len(t) else np.zeros_like(q)
        samples = tuple(JointMotion(q=row, v=speed) for row, speed in zip(q, v, strict=True))
    if len(samples) != len(t):
        raise ShapeError(
            f"targets must have one sample per time; got {len(samples)} for {len(t)} times", name="targets"
        )
    for k, sample in enumerate(samples):
        for name in type(samples[0]).fields(1):
            got, first = (np.shape(getattr(each, name, 0.0)) for each in (sample, samples[0]))
            if got != first:
                raise ShapeError(
                    f"targets must be samples of one kind and size; targets[{k}].{name} has shape {got} and "
                    f"targets[0].{name} {first}",
                    name="targets",
                )
    return Chunk(times=t, samples=samples)


def _through_poses(t: Float64Array, poses: Sequence[Pose]) -> tuple[Sample, ...]:
    """Samples at poses, with twists and accelerations by differences."""
    if len(poses) != len(t):
        return tuple(TaskMotion(pose=pose) for pose in poses)  # which the caller refuses
    p, R = np.stack([pose.p for pose in poses]), np.stack([pose.R for pose in poses])
    twists, accelerations = differences(t, p, R)
    rows = zip(poses, twists, accelerations, strict=True)
    return tuple(TaskMotion(pose=pose, twist=V, acceleration=rate) for pose, V, rate in rows)
