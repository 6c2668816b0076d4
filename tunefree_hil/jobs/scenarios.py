"""List the scenarios with duration, speeds and curvatures, and whether a vehicle can drive them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from tunefree_hil.base.course import Course
from tunefree_hil.base.errors import InputError
from tunefree_hil.base.events import Event
from tunefree_hil.jobs.options.records import ScenariosOptions

TICK_S = 0.01  # tick of a course without a vehicle
MAX_DRAWN = 20  # roads in the figure of a set
CSV_HEADER = "t_s,x_m,y_m,heading_rad,speed_mps,accel_mps2,curvature_1pm"


def scenarios(options: ScenariosOptions) -> Iterator[Event]:
    """List the scenarios, export them with `options.export`, or make roads with `options.roads`."""
    if options.roads is not None:
        return make_roads(options, options.roads)
    if options.export is not None:
        return export_scenarios(options, options.export)
    return list_scenarios(options)


def list_scenarios(options: ScenariosOptions) -> Iterator[Event]:
    """One line a scenario on stdout; with a name all its details. Exit 1 when the vehicle cannot drive one."""
    from tunefree_hil.config.find import available
    from tunefree_hil.config.load import load_scenario, load_vehicle

    vehicle, name = options.vehicle, options.name
    spec = load_vehicle(vehicle) if vehicle else None
    rows = [describe_scenario(load_scenario(one), spec) for one in ([name] if name else available("scenario"))]
    for row in rows:
        yield Event("line", _full_text(row) if name else _short_line(row))
        for problem in row["problems"]:
            yield Event("line", f"{'':20}cannot be driven: {problem}")
    bad = [row["name"] for row in rows if row["problems"]]
    data = {"scenarios": rows, "exit": 1 if bad else 0, "next": []}
    yield Event("result", "", {**data, "sentence": _summary(len(rows), bad, vehicle)})


def export_scenarios(options: ScenariosOptions, folder: Path) -> Iterator[Event]:
    """Write each scenario's reference drive for a foreign controller as `folder/<first 12 digits of its hash>.csv`.

    The EPISODE message contains these digits. One row a tick (SI); x, y, heading and curvature are those of the path at
    the planned position of the rear axle.
    """
    from tunefree_hil.config.find import available
    from tunefree_hil.config.load import load_scenario, load_vehicle
    from tunefree_hil.episode.scenario import build_course

    name = options.name
    tick_s = load_vehicle(options.vehicle).tick_ms / 1000.0 if options.vehicle else TICK_S
    specs = [load_scenario(one) for one in ([name] if name else available("scenario"))]
    for spec in specs:
        yield Event("line", f"{spec.name:<20}{write_reference_drive(build_course(spec, tick_s), spec.hash, folder)}")
    sentence = f"{len(specs)} reference drives in {folder}"
    yield Event("result", sentence, {"sentence": sentence, "folder": str(folder), "next": []})


def make_roads(options: ScenariosOptions, text: str) -> Iterator[Event]:
    """Make a set of roads for a vehicle: one line a road; into `options.out` as scenario files, the first ones drawn.

    Args:
        options: With the vehicle, the seed and the folder.
        text: The set, such as families:20.

    Raises:
        InputError: No vehicle, an unknown set, or a vehicle that no road fits.
    """
    from tunefree_hil.config.check import parse_road_set
    from tunefree_hil.config.load import load_vehicle
    from tunefree_hil.roads import road_set, write_roads

    folder = options.out
    if options.vehicle is None:
        raise InputError("roads are made for a vehicle", key="--vehicle", hint="--vehicle mkz_bywire, for example")
    spec, chosen = load_vehicle(options.vehicle), parse_road_set(text)
    made = road_set(spec, chosen.name, chosen.count, options.seed)
    if folder is not None:
        made = write_roads(folder, made)
    rows = [describe_scenario(road, spec) for road in made]
    for row in rows:
        yield Event("line", _short_line(row))
    sentence = f"{len(made)} roads for {spec.name}, all within its limits"
    data: dict[str, Any] = {"scenarios": rows, "next": []}
    if folder is not None:
        data["figure"] = str(_draw_roads(made[:MAX_DRAWN], spec, folder))
        sentence += f"; written to {folder}"
    yield Event("result", sentence, {**data, "sentence": sentence})


def _draw_roads(roads: Sequence[Any], vehicle: Any, folder: Path) -> Path:
    from tunefree_hil.episode.scenario import build_course
    from tunefree_hil.figures.roads import draw_roads
    from tunefree_hil.figures.style import save

    courses = {road.name: build_course(road, vehicle.tick_ms / 1000.0) for road in roads}
    return save(draw_roads(courses), folder / "roads.png")


def write_reference_drive(course: Course, content_hash: str, folder: Path) -> Path:
    """Write the reference drive of the scenario with this content hash (hex), as `export_scenarios` does."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{content_hash[:12]}.csv"
    part = path.with_suffix(".part")
    part.write_text(_reference_csv(course), encoding="ascii")
    part.replace(path)
    return path


def _reference_csv(course: Course) -> str:
    """The CSV of `export_scenarios`."""
    import numpy as np

    path_m = course.first_station_m + course.spacing_m * np.arange(len(course.path_x_m))
    stations = np.array(course.station_m)
    columns = [course.dt_s * np.arange(len(stations))]
    columns += [np.interp(stations, path_m, np.array(one)) for one in (course.path_x_m, course.path_y_m)]
    columns += [np.interp(stations, path_m, np.array(course.path_heading_rad))]
    columns += [np.array(course.speed_mps), np.array(course.accel_mps2)]
    columns += [np.interp(stations, path_m, np.array(course.path_curvature_1pm))]
    rows = [",".join(f"{value:.6f}" for value in row) for row in np.column_stack(columns)]
    return "\n".join([CSV_HEADER, *rows, ""])


def describe_scenario(spec: Any, vehicle: Any = None) -> dict[str, Any]:
    """A scenario in numbers (SI): duration, length, ranges of speed, acceleration and curvature, exceeded limits."""
    from tunefree_hil.episode.feasible import check_feasible, curvature_by_time, limits_of
    from tunefree_hil.episode.scenario import build_course

    course = build_course(spec, vehicle.tick_ms / 1000.0 if vehicle is not None else TICK_S)
    curvature = [float(one) for one in curvature_by_time(course)]
    speed = [float(one) for one in course.speed_mps]
    return {
        "name": spec.name,
        "description": spec.description,
        "path": spec.path,
        "hash": spec.hash,
        "noise_seed": spec.noise_seed,
        "duration_s": course.ticks * course.dt_s,
        "length_m": float(course.station_m[course.ticks]),
        "speed_mps": [min(speed), max(speed)],
        "accel_mps2": [float(min(course.accel_mps2)), float(max(course.accel_mps2))],
        "curvature_1pm": [min(curvature), max(curvature)],
        "lateral_accel_mps2": max(abs(v * v * k) for v, k in zip(speed, curvature, strict=True)),
        "problems": check_feasible(course, limits_of(vehicle)) if vehicle is not None else [],
    }


def _short_line(row: dict[str, Any]) -> str:
    low, high = row["speed_mps"]
    tight = max(abs(one) for one in row["curvature_1pm"])
    radius = f"{1.0 / tight:.0f} m" if tight > 1e-4 else "none"
    return (
        f"{row['name']:<20}{row['duration_s']:5.0f} s {row['length_m']:5.0f} m  {low:4.1f} to {high:4.1f} m/s"
        f"  smallest radius {radius}"
    )


def _full_text(row: dict[str, Any]) -> str:
    def span(key: str, unit: str) -> str:
        return f"{row[key][0]:.3g} to {row[key][1]:.3g} {unit}"

    return "\n".join(
        [
            f"{row['name']}: {row['description']}",
            f"  duration      {row['duration_s']:.2f} s, {row['length_m']:.1f} m",
            f"  speed         {span('speed_mps', 'm/s')}",
            f"  acceleration  {span('accel_mps2', 'm/s2')}, lateral at most {row['lateral_accel_mps2']:.3g} m/s2",
            f"  curvature     {span('curvature_1pm', '1/m')}",
            f"  noise seed    {row['noise_seed']}",
            f"  file          {row['path']}, SHA-256 {row['hash'][:12]}...",
        ]
    )


def _summary(count: int, bad: list[str], vehicle: str | None) -> str:
    if bad:
        return f"{vehicle} cannot drive {len(bad)} of {count} scenarios: {', '.join(bad)}"
    limits_text = f", all within the limits of {vehicle}" if vehicle else ""
    return f"{count} scenario{'' if count == 1 else 's'}{limits_text}"
