"""The live view: normals and depth of a camera's frames while it films.

`capture` reads a camera or a file at its own rate, drops what comes too late and says so, and records.
`frames` turns the newest frame into a `LiveResult` by the same steps as `reconstruct`. `page` sends it to
a browser, through the server of `report/local_server.py`.
"""
