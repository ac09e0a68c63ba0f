"""The laws of the examples as C: `python export.py` writes the folder law/ of each."""

from pathlib import Path

import taut


def bare_loop() -> taut.Controller:
    """Computed torque on a Unitree Z1 with encoders alone: its velocity is a filtered difference."""
    arm = taut.load_arm("z1")
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0)
    sensing = taut.Sensing(velocity=taut.sensors.Difference(cutoff=60.0))
    return taut.compile(law, arm, rate=1000.0, sensing=sensing, limits=taut.Limits.of(arm))


def franka() -> taut.Controller:
    """An impedance at the tool of an FR3, which adds the gravity torque itself; the torque's rate is limited."""
    arm = taut.load_arm("fr3", tool="fr3_hand_tcp")
    law = taut.laws.Impedance(K=(400.0, 20.0), B=(40.0, 4.0))
    return taut.compile(law, arm, rate=1000.0, adds=("gravity",), limits=taut.Limits.of(arm, rate=True))


def ros2_control() -> taut.Controller:
    """Computed torque with an integral on a UR10; a gain that changes is blended over 0.2 s."""
    arm = taut.load_arm("ur10")
    law = taut.laws.ComputedTorque(kp=100.0, kd=20.0, ki=5.0)
    return taut.compile(law, arm, rate=1000.0, limits=taut.Limits.of(arm, blend=0.2))


def main(folder: Path = Path(__file__).parent) -> None:
    """Write the three."""
    taut.export_c(bare_loop(), folder / "bare_loop" / "law", prefix="arm", real="float")
    taut.export_c(franka(), folder / "franka" / "law", prefix="fr3")
    taut.export_c(ros2_control(), folder / "ros2_control" / "law", prefix="law")


if __name__ == "__main__":
    main()
