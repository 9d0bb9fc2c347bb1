"""A second physics engine behind the arm interface of the dVRK; README.md says what it is for."""
