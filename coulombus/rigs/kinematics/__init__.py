"""How the joints of a rig move its tip in a plane: [kinematics], compiled mechanisms, their checks; no forces."""
