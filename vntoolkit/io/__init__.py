"""Files in and out; the only stage that touches the disk. Every failure is one line that names the file.

`footage/` reads captures as linear frames, `maps_and_meshes/` maps, meshes and scenes in other tools'
formats, `motion/` motion capture, `results/` the folders that the verbs write. `rigs` is rig.json,
`light_files` files of known lamps, `board_pdf` the printed board. `files` checks and hashes, `atomic`
writes to a temporary name and renames it. `conventions` flips axes: camera frame in memory (y down, z
forward), graphics frame on disk (y up, z towards the viewer).
"""
