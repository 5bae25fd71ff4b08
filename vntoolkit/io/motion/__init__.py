"""Motion capture: BVH and Acclaim's ASF/AMC become a `Skeleton` and a `Motion`; corrections of a fit.

Angles in degrees on disk, rotation matrices in memory; lengths keep the file's unit until a scale is
given.
"""
