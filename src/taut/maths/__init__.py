"""What the robot does: kinematics and dynamics as NumPy functions on floats or symbols."""
