"""Shapes and URDF text of Trocar's models. Lengths here are mm; the files written are in m."""
