"""Solvers against dense algebra; seams, lattice and Laplacians by their defining properties."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

from tests.tracking.wrinkled_video import WrinkledVideo
from vntoolkit.errors import BadInput, BadMesh
from vntoolkit.geometry.mesh import (
    cotangent_laplacian,
    edges_from_faces,
    graph_laplacian,
)
from vntoolkit.tracking.edge_prior import EdgePrior
from vntoolkit.tracking.factors import Factor, factor
from vntoolkit.tracking.fit_errors import FitErrors
from vntoolkit.tracking.lattice import TemplateLattice, lattice_on_template
from vntoolkit.tracking.lattice_system import LatticeSystem
from vntoolkit.tracking.modes import modes_of_the_whole, slow_turns, uniform_strains
from vntoolkit.tracking.regularisers import (
    LaplacianRegulariser,
    TranslationRegulariser,
)
from vntoolkit.tracking.slopes import slopes_from_normals
from vntoolkit.tracking.template import template_from_maps


@pytest.fixture(scope="module")
def template():
    video = WrinkledVideo(width=34, height=26)
    mask = np.ones((26, 34), dtype=bool)
    mask[10:14, 15:20] = False
    return template_from_maps(*video.maps(0, mask), video.camera)


def test_laplacians_vanish_inside_a_plane(template) -> None:
    plane = np.column_stack([template.positions_px, template.positions_px @ [0.3, -0.2] + 5])
    count = np.bincount(template.faces.ravel(), minlength=len(plane))
    inside = count == 6
    assert inside.sum() > 300
    laplacian = cotangent_laplacian(plane, template.faces)
    assert np.abs((laplacian @ plane)[inside]).max() < 1e-12 * 1e3
    assert abs(laplacian - laplacian.T).max() < 1e-12


def test_cotangent_laplacian_refuses_a_triangle_without_area() -> None:
    with pytest.raises(BadMesh, match="1 triangles have no area"):
        cotangent_laplacian(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]]))


def test_a_factored_solve_equals_a_dense_one(template, rng: np.random.Generator) -> None:
    count = len(template.pixels)
    laplacian = graph_laplacian(template.edges, count)
    beta = 1.5 / 4.0**2
    solver = LaplacianRegulariser(laplacian, beta)
    rest, data = rng.normal(size=(count, 3)) * 50, rng.normal(size=(count, 3)) * 50
    stacked = np.vstack([laplacian.toarray(), beta * np.eye(count)])
    dense = np.linalg.lstsq(stacked, np.vstack([laplacian @ rest, beta * data]), rcond=None)[0]
    np.testing.assert_allclose(rest + solver.solve(data - rest), dense, atol=4e-4)


def lattice_problem(template, rng: np.random.Generator):
    lattice = lattice_on_template(template, 4)
    links = lattice.edges
    roots = np.tril(rng.normal(size=(lattice.count, 2, 2)))
    blocks = roots @ np.swapaxes(roots, 1, 2)
    weight = rng.uniform(0.1, 2.0, len(links))
    information = np.stack([blocks[:, 0, 0], blocks[:, 0, 1], blocks[:, 1, 1]], axis=1)
    return lattice, links, LatticeSystem(links, lattice.count), information, weight


def errors_problem(template) -> tuple[TemplateLattice, EdgePrior, FitErrors]:
    """A lattice, its lengths, and the expected errors of fits on it."""
    video = WrinkledVideo(width=34, height=26)
    slopes = slopes_from_normals(video.maps(0)[0], video.camera)
    lattice = lattice_on_template(template, 3)
    lengths = EdgePrior(lattice, template, video.camera, slopes)
    return lattice, lengths, FitErrors(lattice, lengths, [2])


def measured(information: np.ndarray, displacement: np.ndarray | float = 0.0) -> Factor:
    """What nodes are measured with that information (m, 3)."""
    return factor(information, np.broadcast_to(displacement, (len(information), 2)))


def by_outline(information: np.ndarray) -> list[Factor]:
    """What is told with errors of its own at every node: by windows and running template nothing."""
    nothing = measured(0.0 * information)
    return [nothing, nothing, measured(information)]


def test_the_lattice_s_system_equals_a_dense_one(template, rng: np.random.Generator) -> None:
    lattice, links, system, information, weight = lattice_problem(template, rng)
    m, e, precision = lattice.count, len(links), np.array([3.0, 1.0, 0.5])
    pull, steps, modes = (rng.normal(size=shape) for shape in ((m, 2), (e, 2), (e, 2, 3)))
    along = np.zeros((e, 2, 2 * m + 3))  # of displacements and coefficients: what a step is compared with
    for k in range(2):
        along[np.arange(e), k, 2 * links[:, 1] + k] = 1.0
        along[np.arange(e), k, 2 * links[:, 0] + k] = -1.0
    along[:, :, 2 * m :] = -modes
    whole = np.einsum("e,eki,ekj->ij", weight, along, along) + 1e-6 * np.eye(2 * m + 3)
    a, b, c = information.T
    whole[: 2 * m, : 2 * m] += sp.block_diag(np.stack([a, b, b, c], axis=1).reshape(-1, 2, 2)).toarray()
    whole[2 * m :, 2 * m :] += precision * np.eye(3)
    right = np.einsum("e,eki,ek->i", weight, along, steps) + np.pad(pull.ravel(), (0, 3))
    dense = np.linalg.solve(whole, right)
    told = Factor(information, pull, np.zeros(m))
    solution = system.solve(told, weight, steps, modes, precision)
    np.testing.assert_allclose(solution.displacement.ravel(), dense[: 2 * m], atol=1e-3 * np.abs(dense).max())
    np.testing.assert_allclose(solution.left, along @ dense - steps, atol=1e-3 * np.abs(dense).max())


def test_four_corners_tell_how_a_whole_sheet_is_stretched_and_sheared(template) -> None:
    lattice = lattice_on_template(template, 4)
    video = WrinkledVideo(width=34, height=26)
    lengths = EdgePrior(lattice, template, video.camera, slopes_from_normals(video.maps(0)[0], video.camera))
    moved = (lengths.centres - lengths.centres.mean(axis=0)) @ np.array([[0.05, -0.02], [-0.02, -0.03]])
    cells = lattice.cells
    corner = np.all((cells == cells.min(axis=0)) | (cells == cells.max(axis=0)), axis=1)
    known = np.where(corner, 100.0, 0.0)
    weight, steps = np.full(len(lengths.edges), 1.0), np.zeros((len(lengths.edges), 2))
    found = LatticeSystem(lengths.edges, lattice.count).solve(
        measured(np.column_stack([known, 0 * known, known]), moved),
        weight,
        steps,
        uniform_strains(lengths.along),
        1.0,
    )
    assert corner.sum() == 4
    np.testing.assert_allclose(found.displacement, moved, atol=0.05 * np.abs(moved).max())


def test_expected_errors_are_the_covariance_of_the_problem_where_measurements_decide(template) -> None:
    """Links so weak that they tell nothing: what is left is the inverse of each node's own information."""
    lattice, lengths, errors = errors_problem(template)
    weight, steps = np.full(len(lengths.edges), 1e-9), np.zeros((len(lengths.edges), 2))
    information = np.tile([4.0, 1.0, 2.0], (lattice.count, 1))
    system = LatticeSystem(lengths.edges, lattice.count)
    none = np.zeros((len(weight), 2, 3))
    solution = system.solve(measured(information), weight, steps, none, 1.0)
    square = errors.expected(solution, by_outline(information), weight**-0.5, solution.left, none[:, :, 0])[0]
    expected = np.trace(np.linalg.inv([[4.0, 1.0], [1.0, 2.0]]))
    assert square.mean() == pytest.approx(expected, rel=0.1)  # of some 100 nodes with 16 samples each


def test_less_strain_than_given_is_expected_where_less_is_left(template) -> None:
    """A figure held at its left: what the lengths to its right are worth shows at a second hold."""
    lattice, lengths, errors = errors_problem(template)
    column = lattice.cells[:, 0]
    held = np.where((column == column.min()) | (column == column.max()), 100.0, 0.0)
    information = np.column_stack([held, 0 * held, held])
    weight, steps = np.ones(len(lengths.edges)), np.zeros((len(lengths.edges), 2))
    system = LatticeSystem(lengths.edges, lattice.count)
    told, none = [], np.zeros((len(weight), 2, 3))
    for misfit in (0.0, 20.0):
        moved = np.column_stack([np.where(column == column.max(), misfit, 0.0), 0 * held])
        solution = system.solve(measured(information, moved), weight, steps, none, 1.0)
        square, _ = errors.expected(
            solution, by_outline(information), weight**-0.5, solution.left, none[:, :, 0]
        )
        told.append(square)
    between = held == 0
    assert told[0][between].mean() < 0.3 * told[1][between].mean()
    left = 2.0 * solution.left
    expected, _ = errors.expected(solution, by_outline(information), weight**-0.5, left, none[:, :, 0])
    assert expected[between].mean() > 2.0 * told[1][between].mean()  # half of it was expected


def test_it_is_said_how_far_other_things_than_its_guess_tell_of_a_link(template) -> None:
    """The left half of a figure is measured, the right one only guessed."""
    lattice, lengths, errors = errors_problem(template)
    left = lattice.cells[:, 0] < np.median(lattice.cells[:, 0])
    information = np.column_stack([100.0 * left, 0.0 * left, 100.0 * left])
    weight, steps = np.ones(len(lengths.edges)), np.zeros((len(lengths.edges), 2))
    none = np.zeros((len(weight), 2, 3))
    solution = LatticeSystem(lengths.edges, lattice.count).solve(
        measured(information), weight, steps, none, 1.0
    )
    _, told = errors.expected(solution, by_outline(information), weight**-0.5, solution.left, none[:, :, 0])
    assert told[left[lengths.edges].all(axis=1)].min() > 0.9
    assert told[~left[lengths.edges].any(axis=1)].mean() < 0.5  # guesses that disagree tell of one another


def test_where_links_depart_farther_than_elsewhere_more_strain_is_expected(template) -> None:
    lattice, lengths, errors = errors_problem(template)
    none, weight = np.zeros((len(lengths.edges), 2, 3)), np.ones(len(lengths.edges))
    information = np.tile([0.1, 0.0, 0.1], (lattice.count, 1))
    upper = lattice.cells[:, 1] < np.median(lattice.cells[:, 1])
    system, told = LatticeSystem(lengths.edges, lattice.count), []
    for departs in (np.ones(len(weight)), np.where(upper[lengths.edges].all(axis=1), 3.0, 1.0)):
        steps = departs[:, None] * np.random.default_rng(0).normal(size=(len(weight), 2))
        solution = system.solve(measured(information), weight, steps, none, 1.0)
        square, _ = errors.expected(
            solution, by_outline(information), weight**-0.5, solution.left, none[:, :, 0]
        )
        told.append(square)
    alike, unlike = told
    share = unlike[upper].mean() / unlike[~upper].mean()
    assert share > 1.5 * alike[upper].mean() / alike[~upper].mean()


def test_slow_turns_turn_steps_as_far_as_a_polynomial_of_their_place(rng: np.random.Generator) -> None:
    steps, middles = rng.normal(size=(50, 2)), rng.uniform(0, 300, (50, 2))
    x, y = ((middles - middles.mean(axis=0)) / middles.std(axis=0)).T
    angle = 1e-3 * (1.0 + 2.0 * x - y + 0.5 * x * y - x**2)
    turned = np.stack(
        [np.cos(angle) * steps[:, 0] - np.sin(angle) * steps[:, 1],
         np.sin(angle) * steps[:, 0] + np.cos(angle) * steps[:, 1]], axis=1
    )  # fmt: skip
    modes = slow_turns(steps, middles)
    found = np.linalg.lstsq(modes.reshape(100, -1), (turned - steps).ravel(), rcond=None)[0]
    np.testing.assert_allclose(steps + modes @ found, turned, atol=1e-4)


def test_the_whole_may_stretch_and_turn_beside_its_guesses(rng: np.random.Generator) -> None:
    steps, middles = rng.normal(size=(50, 2)), rng.uniform(0, 300, (50, 2))
    modes, precision = modes_of_the_whole(steps, middles)
    turn = Rotation.from_rotvec([0.0, 0.0, 4e-4]).as_matrix()[:2, :2]
    departs = (steps @ (turn @ np.diag([1.001, 0.998]) - np.eye(2)).T).ravel()
    found = np.linalg.lstsq(modes.reshape(100, -1), departs, rcond=None)[0]
    np.testing.assert_allclose(modes.reshape(100, -1) @ found, departs, atol=1e-6)
    assert precision.shape == (modes.shape[2],)


def test_half_of_a_wave_passes_at_the_stated_wavelength() -> None:
    count, length = 400, 6.0
    edges = np.stack([np.arange(count - 1), np.arange(1, count)], 1)
    solver = LaplacianRegulariser(graph_laplacian(edges, count), 1.5 / length**2)
    wave = np.cos(2 * np.pi * np.arange(count) / (5.13 * length))[:, None]
    passed = solver.solve(wave)[100:300, 0] @ wave[100:300, 0] / (wave[100:300, 0] @ wave[100:300, 0])
    assert 0.48 < passed < 0.52


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_translations_equal_a_dense_solve(template, rng: np.random.Generator, share: float) -> None:
    count = len(template.pixels)
    data = rng.normal(size=(count, 3))
    solver = TranslationRegulariser(template.edges, count, share)
    matrix = share * np.eye(count) + (1 - share) * graph_laplacian(template.edges, count).toarray()
    np.testing.assert_allclose(solver.solve(data), np.linalg.solve(matrix, share * data), atol=1e-4)
    assert TranslationRegulariser(template.edges, count, 1.0).solve(data) == pytest.approx(data)


def test_faces_look_at_the_viewer(template) -> None:
    corners = template.vertices_in_camera[template.faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (normals[:, 2] < 0).all()


def test_a_seam_parts_the_mesh_where_it_is_drawn() -> None:
    video = WrinkledVideo(width=40, height=30)
    whole = template_from_maps(*video.maps(0), video.camera)
    cut = template_from_maps(*video.maps(0), video.camera, [np.array([[10.0, 14.5], [30.0, 14.5]])])
    parted = np.setdiff1d(_codes(whole.edges), _codes(cut.edges))
    assert len(parted) in (20, 21)  # columns 10 to 30; a vertex in line with the seam's end is on one side
    assert set(whole.pixels[parted // 1200, 1]) == {14}
    assert set(whole.pixels[parted % 1200, 1]) == {15}
    assert len(np.intersect1d(_codes(edges_from_faces(cut.faces)), parted)) == 0


def _codes(edges) -> np.ndarray:
    return edges[:, 0].astype(np.int64) * 1200 + edges[:, 1]


def test_both_sides_of_a_seam_move_freely() -> None:
    video = WrinkledVideo(width=64, height=48)
    seam = [np.array([[0.0, 23.5], [63.0, 23.5]]), np.array([[63.0, 23.5], [63.0, 23.4]])]
    template = template_from_maps(*video.maps(0), video.camera, seam)
    count = len(template.pixels)
    below = template.pixels[:, 1] >= 24
    offsets = np.where(below, 3.0, -3.0)[:, None]
    crossing = below[template.edges[:, 0]] != below[template.edges[:, 1]]
    assert crossing.sum() <= 1
    solver = LaplacianRegulariser(graph_laplacian(template.edges[~crossing], count), 1.5 / 8.0**2)
    np.testing.assert_allclose(solver.solve(offsets), offsets, atol=1e-3)
    lattice = lattice_on_template(template, 8)
    sums = lattice.smoothed(lattice.sums(np.column_stack([offsets, np.ones(count)])), 1)
    means = sums[:, :1] / sums[:, 1:]
    far = np.abs(template.pixels[:, 0] - 31) < 20
    np.testing.assert_allclose(lattice.at_vertices(means)[far], offsets[far], atol=1e-9)


def test_a_seam_off_the_mask_is_refused() -> None:
    video = WrinkledVideo(width=40, height=30)
    mask = np.ones((30, 40), dtype=bool)
    mask[:, 30:] = False
    with pytest.raises(BadInput, match=r"seam 0: point \(35, 10\) is off the template's mask"):
        template_from_maps(*video.maps(0, mask), video.camera, [np.array([[10.0, 10], [35, 10]])])
    with pytest.raises(BadInput, match="seam 0: expected two points"):
        template_from_maps(*video.maps(0), video.camera, [np.array([[10.0, 10]])])


def test_shut_lips_are_cut_and_a_seam_may_cross_the_dark_between_them() -> None:
    video = WrinkledVideo(width=40, height=30)
    mask = np.ones((30, 40), dtype=bool)
    mask[14:17, 18:22] = False
    line = np.array([[10.0, 15.5], [30.0, 15.5]])
    template = template_from_maps(*video.maps(0, mask), video.camera, [line, line])
    across = template.pixels[template.edges][..., 1]
    column = template.pixels[template.edges[:, 0], 0]
    over = (column > 10) & (column < 30) & (across.min(axis=1) == 15) & (across.max(axis=1) == 16)
    assert not over.any()
    assert ((column < 9) & (across.min(axis=1) == 15) & (across.max(axis=1) == 16)).sum() == 9


def test_which_of_two_guesses_holds_is_one_doubt_for_all_links_and_what_is_held_is_free_of_it(template):
    lattice, lengths, errors = errors_problem(template)
    column = lattice.cells[:, 0]
    held = np.where(column == column.min(), 1e4, 0.0)
    information = np.column_stack([held, 0 * held, held])
    weight, steps = np.ones(len(lengths.edges)), np.zeros((len(lengths.edges), 2))
    none = np.zeros((len(weight), 2, 3))
    solution = LatticeSystem(lengths.edges, lattice.count).solve(
        measured(information), weight, steps, none, 1.0
    )
    sure, doubted = (
        errors.expected(solution, by_outline(information), weight**-0.5, solution.left, doubt)[0]
        for doubt in (steps, 0.1 * lengths.along)  # a tenth of every length
    )
    expected = np.square(0.1 * (lengths.centres - lengths.centres[column == column.min()].mean(axis=0))[:, 0])
    far = column == column.max()
    np.testing.assert_allclose((doubted - sure)[far], expected[far], rtol=0.2)
    assert np.abs(doubted - sure)[held > 0].max() < 0.1
