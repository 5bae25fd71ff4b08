"""What people look at: figures, pictures of maps and meshes, HTML pages, the 3-D viewer.

`report` writes report.html of a reconstruction, `head` that of a head's calibration, `recipes_page` that
of the recipes; all are made of `page` sections and fetch nothing. `scene` is the 3-D page, whose frames
`result_scene` serves through `local_server` or thins into one file. `pictures` and `figures` share one
look; `mesh_views` draws meshes without a graphics card. Nothing here computes a result.
"""
