"""Reading a file never runs it, and no name in a file leads out of its folder."""

import ast
from pathlib import Path

import numpy as np
import pytest
from specimens import a_mesh

from tests.result_files import write_mesh_sequence
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.results.sequences import read_mesh_sequence

PACKAGE = Path(__file__).parents[2] / "vntoolkit"
FORBIDDEN_MODULES = {"pickle", "cPickle", "dill", "cloudpickle", "shelve", "marshal", "joblib"}
FORBIDDEN_CALLS = {"eval", "exec", "compile", "__import__"}
FORBIDDEN_METHODS = {
    ("os", "system"), ("os", "popen"), ("yaml", "load"), ("yaml", "unsafe_load"), ("torch", "load"),
    ("subprocess", "getoutput"), ("subprocess", "getstatusoutput"), ("tarfile", "open"),
    ("zipfile", "ZipFile"), ("shutil", "unpack_archive"), ("tempfile", "mktemp"),
}  # fmt: skip


def faults_of(tree: ast.AST) -> list[str]:
    """Return what in a module could run a file's content, or unpack it to anywhere."""
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names if alias.name.split(".")[0] in FORBIDDEN_MODULES]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] in FORBIDDEN_MODULES:
            found.append(node.module)
        elif isinstance(node, ast.Call):
            found += _faults_of_call(node)
    return found


def _faults_of_call(call: ast.Call) -> list[str]:
    found = []
    function = call.func
    if isinstance(function, ast.Name) and function.id in FORBIDDEN_CALLS:
        found.append(function.id)
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name):
        written = [a.value for a in call.args[1:2] if isinstance(a, ast.Constant)] == ["w"]
        if (function.value.id, function.attr) in FORBIDDEN_METHODS and not written:
            found.append(f"{function.value.id}.{function.attr}")
        is_load = (function.value.id, function.attr) in (("np", "load"), ("numpy", "load"))
        pickles = [k.value for k in call.keywords if k.arg == "allow_pickle"]
        if is_load and not all(isinstance(v, ast.Constant) and v.value is False for v in pickles):
            found.append("np.load with pickle")
    for keyword in call.keywords:
        true = isinstance(keyword.value, ast.Constant) and keyword.value.value is True
        if keyword.arg in ("shell", "allow_pickle") and (true or not isinstance(keyword.value, ast.Constant)):
            found.append(f"{keyword.arg}=True")
    return found


@pytest.mark.parametrize(
    "path", sorted(PACKAGE.rglob("*.py")), ids=lambda p: p.relative_to(PACKAGE).as_posix()
)
def test_nothing_runs_what_it_reads(path):
    assert faults_of(ast.parse(path.read_text())) == []


@pytest.mark.parametrize(
    "code",
    ["import pickle", "from pickle import loads", "eval(x)", "subprocess.run(x, shell=True)", "yaml.load(x)",
     "np.load(p, allow_pickle=True)", "zipfile.ZipFile(p)", "zipfile.ZipFile(p, mode)",
     "subprocess.run(x, shell=flag)", "os.system(x)"],
)  # fmt: skip
def test_the_audit_sees_what_it_looks_for(code):
    assert faults_of(ast.parse(code)) != []


def test_a_list_of_photographs_cannot_name_a_file_outside_its_folder(tmp_path):
    folder = tmp_path / "lights"
    folder.mkdir()
    (folder / "light_directions.txt").write_text("0 0 1\n0.1 0 1\n")
    (folder / "filenames.txt").write_text("001.png\n../../etc/passwd\n")
    with pytest.raises(BadInput, match="outside its folder"):
        read_lights(folder)


def test_pickled_arrays_are_refused(tmp_path):
    from vntoolkit.geometry.mesh import MeshSequence

    mesh = a_mesh()
    vertices = np.repeat(np.asarray(mesh.vertices, dtype=np.float32)[None], 2, axis=0)
    write_mesh_sequence(tmp_path, MeshSequence(template=mesh, vertices=vertices))
    np.save(tmp_path / "vertices.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(BadMesh, match=r"not a whole \.npy array"):
        read_mesh_sequence(tmp_path)
