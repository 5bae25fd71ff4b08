"""Errors of results against references.

Angles between normals in degrees (`angular_error`), depth after its free scale or offset is removed
(`depth_error`), distances between meshes by pymeshlab (`mesh_comparison`), tracked vertices in pixels of
the footage (`track_error`), and the one cylinder that fits all frames (`cylinder`, `cylinder_fit`: Figure
7 of brostow2011). Each returns one frozen object with its summary; a reference of another size or frame is
refused.
"""
