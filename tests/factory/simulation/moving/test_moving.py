"""Moving objects: their level, place, shadow and grain; reproducible casts; refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any, get_args

import numpy as np
import pytest

from simnfnd.factory.common.errors import FactoryError
from simnfnd.factory.common.settings import build
from simnfnd.factory.dataset.frame_ref import FrameRef
from simnfnd.factory.dataset.meaning import ObjectName
from simnfnd.factory.simulation.config.root import FactoryConfig
from simnfnd.factory.simulation.imaging.coherent import CoherentScene, received
from simnfnd.factory.simulation.meshes.camera import movements
from simnfnd.factory.simulation.moving.cast import draw_cast
from simnfnd.factory.simulation.moving.compose import Echo, bodies_at, compose
from simnfnd.factory.simulation.moving.fish import SwimmingWave, fish_mesh, love_target_strength_db
from simnfnd.factory.simulation.noise.draws import StreamNames, draw
from simnfnd.factory.simulation.pairs.pair_maker import make_pair, observe_moment
from simnfnd.factory.simulation.render.view import decode, encode, view_of
from simnfnd.factory.simulation.scenes.moving import TRACKS_BYTES, largest_track_bytes, waypoints
from simnfnd.factory.simulation.scenes.seabed import SeabedReader, SeabedSettings
from tests.factory.simulation.moving.stage import Line, ball, moment, plane, settings, slab

SILENT_GROUND = {"reflectivity_db": {"Background": -80.0}}


def scene(config: Any, *actors: Any, **ground: Any) -> CoherentScene:
    actual = observe_moment(moment(list(actors), **ground), config).scene
    assert isinstance(actual, CoherentScene)
    return actual


@pytest.mark.parametrize(
    ("actor", "range_m", "elevation_deg"),
    [
        (ball(Line((4.0, 0.3, 0.0))), np.hypot(4.0, 0.3), 0),
        (ball(Line((6.0, -0.5, -0.4)), 0.08), np.sqrt(36 + 0.25 + 0.16), 3.8),
        (ball(Line((5.0, 0.0, 0.0)), mesh=slab((0.05, 0.3, 0.1))), 5.0, 0),
    ],
)
def test_target_strength_gives_the_level_of_the_sonar_equation(actor, range_m, elevation_deg):
    config = settings(acoustics=SILENT_GROUND)
    ping = scene(config, actor)
    # EL - SL = TS - 40 log r - 2 a r + the two-way vertical pattern (Urick 1983, ch. 2).
    from simnfnd.factory.simulation.sonar.surface import vertical_table

    table = vertical_table(config.sonar)
    pattern = table[round((np.sin(np.deg2rad(elevation_deg)) + 1) / 2 * (len(table) - 1))]
    loss_db = 40 * np.log10(range_m) + 2 * ping.absorption_db_per_m * range_m
    theory_db = -25 - loss_db + 10 * np.log10(pattern)
    assert 10 * np.log10(ping.scatterers.power.sum()) == pytest.approx(theory_db, abs=0.5)
    # The beams keep the energy, so the level in the image is theory's, too.
    assert 10 * np.log10(ping.expected.sum()) == pytest.approx(theory_db, abs=0.5)


def test_tracks_match_the_brightest_cell():
    moving = {"kind": "seabed", "frame_rate_hz": 10, "moving_objects": [{}]}
    config = settings(acoustics=SILENT_GROUND, scenes=moving, dataset={"columns": ["tracks"]})
    course = Line((3.0, 0.5, 0.05), (0.4, -0.2, 0.0))
    for time_s in (0.0, 1.0, 2.0, 3.5):
        observed = observe_moment(moment([ball(course, 0.03)], time_s), config)
        assert isinstance(observed.scene, CoherentScene)
        expected = observed.scene.expected
        row, beam = np.unravel_index(np.argmax(expected), expected.shape)
        (track,) = json.loads(str(observed.columns["tracks"]))
        bins_per_m = config.sonar.range_bins / observed.window.range_span_m
        track_row = (track["range_m"] - observed.window.range_min_m) * bins_per_m - 0.5
        bearings = np.rad2deg(config.sonar.beam_centres_rad())
        track_beam = np.interp(track["bearing_deg"], bearings, np.arange(len(bearings)))
        assert abs(track_row - row) <= 1
        assert abs(track_beam - beam) <= 1
        left, top, width, height = track["box"]
        assert left <= beam < left + width
        assert top <= row < top + height
        assert track["velocity_m_s"] == pytest.approx([0.4, -0.2, 0.0], abs=1e-3)
        assert track["insonified"] > 0.9
        assert track["target_strength_db"] == -25


def test_tracks_state_the_length_and_the_axis_of_a_body():
    moving = {"kind": "seabed", "frame_rate_hz": 10, "moving_objects": [{}]}
    config = settings(acoustics=SILENT_GROUND, scenes=moving, dataset={"columns": ["tracks"]})
    plank = ball(Line((4.0, 0.0, 0.0), turn_rad_s=0.5), mesh=slab((0.6, 0.1, 0.05)), length_m=0.0)
    for time_s, bearing_deg in ((0.0, 0.0), (1.0, -np.rad2deg(0.5))):
        observed = observe_moment(moment([plank], time_s), config)
        (track,) = json.loads(str(observed.columns["tracks"]))
        assert track["length_m"] == pytest.approx(0.6, abs=1e-3)
        # A body that turns to the left points to negative bearings.
        assert track["body_bearing_deg"] == pytest.approx(bearing_deg, abs=0.01)


def test_an_object_throws_a_shadow_and_may_be_hidden():
    config = settings()
    low = ball(Line((3.0, 0.0, -1.2)), 0.15)
    observed, empty = (observe_moment(moment(actors), config) for actors in ([low], []))
    newly_dark = observed.shadow & ~empty.shadow
    rows, beams = np.nonzero(newly_dark)
    range_m = 2 + 6 * rows / config.sonar.range_bins
    # The ground behind it, up to the ray over its top: 1.5 / tan of that ray's angle.
    assert range_m.min() > 3.2
    assert np.percentile(range_m, 90) < 1.1 * 3.0 * 1.5 / (1.2 - 0.15)
    assert abs(np.median(beams) - 47.5) < 3
    buried = moment([ball(Line((5.0, 0.0, -1.7)), 0.15)])
    composed = compose(
        buried.frame, buried.rendered, buried.bodies, config.sonar.mount, [Echo(0.003, 2)], 900
    )
    moving = composed.frame.moving
    assert moving is not None
    assert moving.hidden_px[0] > 0
    assert not len(moving.pixel)


def test_objects_change_neither_window_nor_scale_nor_the_static_layer():
    config = settings(dataset={"layers": ["static"]}, noise={"speckle": {}})
    loud = ball(Line((4.0, 0.0, 0.0)), 0.2, strength=0.0)
    with_object, without = (observe_moment(moment(actors), config) for actors in ([loud], []))
    pairs = [make_pair(observed_frame, 0, config) for observed_frame in (with_object, without)]
    assert pairs[0].record["full_scale"] == pairs[1].record["full_scale"]
    np.testing.assert_array_equal(pairs[0].layers["static"], pairs[1].layers["static"])
    assert (pairs[0].clean != pairs[1].clean).any()
    np.testing.assert_array_equal(pairs[1].clean, pairs[1].layers["static"])


def grains(effect: str, actors: list[Any], times_s: list[float], side_m: float) -> Any:
    """Correlation of an object's grain with that of the first time, as it moves along range."""
    config = settings(acoustics=SILENT_GROUND, noise={effect: {}})
    actual = []
    for time_s in times_s:
        observed_frame = observe_moment(moment(actors, time_s), config)
        assert isinstance(observed_frame.scene, CoherentScene)
        names = StreamNames.of(observed_frame.ref, 0, observed_frame.has_pose)
        effects = draw(config.noise, 0, names, continuous=True).effects
        field = received(observed_frame.scene, effects) ** 2
        centre_m = actors[0].course.at(time_s).position_m[0]
        row = round((centre_m - 2.0) * config.sonar.range_bins / 6.0)
        reach = round(side_m / 2 * config.sonar.range_bins / 6.0)
        actual.append(field[row - reach : row + reach, 44:52])
    first = actual[0].ravel()
    return [float(np.corrcoef(first, intensity.ravel())[0, 1]) for intensity in actual]


def test_the_grain_of_an_object_moves_with_it():
    # A slab that leans, so that its face fills range bins, and moves by range bins.
    leaning = slab((1.2, 0.8, 0.02)).turned("y", -0.5)
    actor = ball(Line((4.0, 0.0, 0.0), (0.2, 0, 0)), mesh=leaning, strength="material")
    speckle = grains("speckle", [actor], [0.0, 0.1, 0.5, 1.0], 0.7)
    # The view of it changes a little on the way; the ground's grain would be another one at once.
    assert min(speckle) > 0.5
    standing = replace(actor, course=Line((4.0, 0.0, 0.0)))
    assert min(grains("path_speckle", [standing], [0.0, 1.0], 0.7)) == pytest.approx(1)
    # The phase of the path tells a turn of a few wavelengths over its width.
    turning = replace(actor, course=Line((4.0, 0.0, 0.0), turn_rad_s=0.2))
    remaining = grains("path_speckle", [turning], [0.0, 0.1, 0.2, 0.3], 0.7)
    assert remaining[3] < 0.3


def test_the_grain_of_a_swimming_fish_changes_within_three_frames():
    fish = fish_mesh(0.8, 0.3)
    swimming = ball(
        Line((4.0, 0.0, 0.0), (0.3, 0.0, 0.0)),
        mesh=fish,
        wave=SwimmingWave(0.8, 1.5, 0.0),
        strength="love",
        length_m=0.8,
    )
    remaining = grains("path_speckle", [swimming], [0.0, 0.1, 0.2, 0.3], 0.6)
    assert min(remaining[1:]) < 0.3


def test_a_fish_has_its_length_bends_and_keeps_its_spine():
    fish = fish_mesh(0.4, 0.25)
    assert np.ptp(fish.vertices, axis=0) == pytest.approx([0.4, 0.055, 0.1], rel=0.1)
    wave = SwimmingWave(0.4, 2.0, 0.3)
    first, later, after = (wave.bent(fish.vertices, time_s) for time_s in (0.0, 0.1, 0.5))
    np.testing.assert_allclose(first, after, atol=1e-12)  # a beat takes half a second
    tail = fish.vertices[:, 0] < -0.19
    swing_m = np.abs(later - fish.vertices)[tail, 1].max()
    assert 0.01 < swing_m <= 0.11 * 0.4
    np.testing.assert_array_equal(later[:, [0, 2]], fish.vertices[:, [0, 2]])


def test_love_gives_published_numbers():
    # 19.1 log10 L - 0.9 log10 f - 62.0 (Love 1977): 30 cm at 1 MHz, 10 cm at 1.8 MHz.
    assert love_target_strength_db(0.30, 1000) == pytest.approx(-36.49, abs=0.01)
    assert love_target_strength_db(0.10, 1800) == pytest.approx(-45.83, abs=0.01)


def with_objects(*objects: dict[str, Any], **keys: Any) -> SeabedSettings:
    values = {"kind": "seabed", "frame_rate_hz": 8, "moving_objects": list(objects), **keys}
    settings: SeabedSettings = build(SeabedSettings, values, "scenes")
    return settings


def test_a_cast_depends_on_seed_and_recording_alone():
    school = {"moving": {"school": {"count": {"uniform": [5, 9]}}, "target_strength": "love"}}
    chosen = with_objects(school, {"object": "Tire", "moving": {"id": 1, "height_m": 1}})
    around = plane()[0].surroundings
    assert around is not None

    def places(seed: int, scene: str, number: str = "0000") -> Any:
        cast = draw_cast(chosen, seed, FrameRef("seabed", scene, number), around)
        actual = [actor.course.at(2.0) for actor in cast]
        return [actor.number for actor in cast], np.stack(
            [placement.position_m for placement in actual if placement]
        )

    numbers, first = places(0, "seabed-0001")
    np.testing.assert_array_equal(first, places(0, "seabed-0001", "0005")[1])
    assert numbers == list(range(1, len(numbers) + 1))
    for different in (places(1, "seabed-0001"), places(0, "seabed-0002")):
        assert different[1].shape != first.shape or (different[1] != first).any()
    assert (first[:, 2] >= -1.5).all()  # above the ground


def test_a_recording_shares_one_render_and_its_surroundings_survive_the_cache():
    chosen = with_objects(locations=1, frames_per_location=3, width=96, height=64)
    refs = SeabedReader(chosen).discover().frames
    assert [chosen.rendered_ref(ref).frame for ref in refs] == ["0000"] * 3
    assert [chosen.time_s(ref) for ref in refs] == [0, 0.125, 0.25]
    frame, rendered = plane()
    view = view_of(frame, rendered, settings().sonar.mount)
    read = decode(encode(view)).unnamed_frame.surroundings
    assert read is not None
    assert frame.surroundings is not None
    np.testing.assert_array_equal(read.world_from_start, frame.surroundings.world_from_start)
    np.testing.assert_array_equal(read.ground_m, frame.surroundings.ground_m)


@pytest.mark.parametrize(
    ("objects", "key"),
    [
        ([{"moving": {"speed_m_s": 300}}], "scenes.moving_objects.0.moving.speed_m_s"),
        ([{"moving": {"id": 3}}, {"moving": {"id": 3}}], "scenes.moving_objects.1.moving.id"),
        ([{"object": "Tire", "moving": {"target_strength": "love"}}], "moving.target_strength"),
        ([{"object": "Whale"}], "scenes.moving_objects.0.object"),
    ],
)
def test_refusals_name_the_key(objects, key):
    with pytest.raises(FactoryError, match=key.replace(".", r"\.")) as refusal:
        with_objects(*objects)
    assert "\n" not in str(refusal.value)


def test_numbers_of_a_school_are_its_own():
    school = {"moving": {"id": 1, "school": {"count": 4}}}
    chosen = with_objects(school, {"moving": {"id": 3}})
    around = plane()[0].surroundings
    assert around is not None
    with pytest.raises(FactoryError, match=r"scenes\.moving_objects\.1\.moving\.id"):
        draw_cast(chosen, 0, FrameRef("seabed", "seabed-0000", "0000"), around)


HEADER = "time_s,x_m,y_m,z_m,yaw_deg,pitch_deg,roll_deg\n"


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "header"),
        ("time,x,y\n0,1,2\n", "header"),
        (HEADER + "0,1,0,0,0,0,0\n1,1,99,0,0,0,0\n", "file.csv:3"),
        (HEADER + "0,1,0,0,0,0,0\n0,2,0,0,0,0,0\n", "file.csv:3"),
        (HEADER + "0,1,0,0,0,0,0\n0.01,9,0,0,0,0,0\n", "file.csv:3"),
        (HEADER + "0,1,0,0,0,0,0\n1,2,nan,0,0,0,0\n", "file.csv:3"),
    ],
)
def test_a_bad_path_is_one_line_that_names_file_and_line(tmp_path: Path, text, word):
    file = tmp_path / "file.csv"
    file.write_text(text)
    chosen = with_objects({"moving": {"path": str(file)}}, locations=1, frames_per_location=2)
    with pytest.raises(FactoryError, match=word) as refusal:
        SeabedReader(chosen).discover()
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize("name", get_args(ObjectName))
def test_every_built_in_object_moves(name):
    """Beside a fish: one that cannot be drawn would fail the frame."""
    chosen = with_objects(
        {"object": name, "moving": {"start": {"range_m": 5, "bearing_deg": 0}, "height_m": 1.5}},
        {"moving": {"start": {"range_m": 3, "bearing_deg": 0}, "height_m": 1.5}},
    )
    frame, rendered = plane()
    assert frame.surroundings is not None
    cast = draw_cast(chosen, 0, FrameRef("seabed", "seabed-0000", "0000"), frame.surroundings)
    bodies = bodies_at(cast, frame, 0.0)
    echoes = [Echo(0.01, 2.0)] * 64
    composed = compose(frame, rendered, bodies, settings().sonar.mount, echoes, 1000.0)
    moving = composed.frame.moving
    assert moving is not None
    names = [body.actor.class_name for body in bodies]
    assert sorted(names) == sorted([name, "Fish"])
    assert (moving.alone_px > 0).all(), names


def test_a_school_that_the_tracks_cannot_hold_is_refused():
    def chosen(count: Any, class_name: str = "Fish") -> FactoryConfig:
        school = {"class": class_name, "moving": {"school": {"count": count}}}
        scenes = {"kind": "seabed", "frame_rate_hz": 10, "moving_objects": [school]}
        return settings(scenes=scenes, dataset={"columns": ["tracks"]})

    capacity = TRACKS_BYTES // largest_track_bytes("Fish")
    assert 60 < capacity < 120
    assert chosen(capacity)
    assert chosen({"normal": [20, 5]})
    for count in (capacity + 1, {"uniform": [1, 300]}):
        with pytest.raises(FactoryError, match=r"dataset\.columns.*school\.count"):
            chosen(count)
    with pytest.raises(FactoryError, match=r"dataset\.columns"):
        chosen(capacity, "A fish with a longer name")


def test_no_entry_of_the_tracks_is_longer_than_expected():
    actor = ball(Line((4.0, 0.0, 0.0)), number=9999, class_name="Ball")
    scenes = {"kind": "seabed", "frame_rate_hz": 10, "moving_objects": [{}]}
    chosen = settings(scenes=scenes, dataset={"columns": ["tracks"]})
    lit = observe_moment(moment([actor]), chosen).columns
    text = str(lit["tracks"])
    assert len(json.loads(text)) == 1
    assert 100 < len(text) <= largest_track_bytes("Ball") + 1


@pytest.mark.parametrize(("first_s", "last_s"), [(100, 200), (-9, -1), (0.2, 9)])
def test_a_path_outside_the_recording_is_refused(tmp_path: Path, first_s, last_s):
    file = tmp_path / "file.csv"
    file.write_text(HEADER + f"{first_s},3,0,0,0,0,0\n{last_s},4,0,0,0,0,0\n")
    chosen = with_objects({"moving": {"path": str(file)}}, locations=1, frames_per_location=2)
    with pytest.raises(FactoryError, match=r"moving_objects\.0\.moving\.path.*outside"):
        SeabedReader(chosen).discover()
    longer = with_objects({"moving": {"path": str(file)}}, locations=1, frames_per_location=2000)
    if first_s > 0:
        assert SeabedReader(longer).discover().frames


def test_the_time_of_a_platform_counts_from_its_first_line(tmp_path: Path):
    platform = tmp_path / "platform.csv"
    platform.write_text("time_s,surge_m\n1700000000,0\n1700000002,0.5\n")
    file = tmp_path / "file.csv"
    file.write_text(HEADER + "1,3,0,0,0,0,0\n9,4,0,0,0,0,0\n")
    chosen = with_objects({"moving": {"path": str(file)}}, locations=1, path=str(platform))
    assert len(SeabedReader(chosen).discover().frames) == 2
    assert chosen.start_s == 1_700_000_000
    platform.write_text("time_s,surge_m\n2,0\n1,0.5\n")
    movements.cache_clear()
    with pytest.raises(FactoryError, match=r"platform\.csv:3: time_s"):
        SeabedReader(chosen).discover()


def test_a_path_is_followed_from_the_sonars_first_place(tmp_path: Path):
    file = tmp_path / "file.csv"
    file.write_text(HEADER + "0,3,0,0,0,0,0\n2,5,1,-0.4,90,0,0\n")
    assert waypoints(file, "key").time_s.tolist() == [0, 2]
    chosen = with_objects({"object": "Barrel", "moving": {"path": str(file)}})
    around = plane()[0].surroundings
    assert around is not None
    (actor,) = draw_cast(chosen, 0, FrameRef("seabed", "seabed-0000", "0000"), around)
    placement = actor.course.at(1.0)
    assert placement is not None
    np.testing.assert_allclose(placement.position_m, [4, 0.5, -0.2], atol=1e-9)
    ahead = placement.world_from_own[:, 0]
    np.testing.assert_allclose(ahead, [np.sqrt(0.5), np.sqrt(0.5), 0], atol=1e-9)
    assert actor.course.at(2.1) is None


def test_groups_of_beams_see_an_object_one_after_another():
    fast = ball(Line((4.0, 0.0, 0.0), (20.0, 0.0, 0.0)), 0.1)
    actors = [fast]
    array = {"beam_groups": 2, "beamwidth_deg": 0.3}
    together, in_turns = (
        settings(acoustics=SILENT_GROUND, sonar={"array": beams})
        for beams in ({"beamwidth_deg": 0.3}, array)
    )
    now = replace(moment(actors), cast=actors)
    # 8 m and back: the second group hears the ball 0.2 m farther away.
    wait_s = 16 / in_turns.water.sound_speed_m_s()
    first, second, turns = (
        make_pair(observe_moment(at, config), 0, config).clean
        for at, config in (
            (now, together), (now.later(wait_s), together), (now, in_turns),
        )
    )  # fmt: skip
    np.testing.assert_array_equal(turns[:, ::2], first[:, ::2])
    np.testing.assert_array_equal(turns[:, 1::2], second[:, 1::2])
    rows = []
    for at in (now, now.later(wait_s)):
        ping = observe_moment(at, together).scene
        assert isinstance(ping, CoherentScene)
        rows.append(int(np.argmax(ping.expected[:, 46:50].max(axis=1))))
    row_now, row_then = rows
    assert row_then - row_now == pytest.approx(20 * wait_s * 50, abs=1.5)
    plain = make_pair(observe_moment(replace(now, cast=()), together), 0, together)
    np.testing.assert_array_equal(plain.clean, first)
