"""What the robot is: joints, bodies, frames and limits, and the ways to load them. Data, no maths."""
