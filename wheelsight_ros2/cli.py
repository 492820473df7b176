"""`wheelsight foxglove-layout`: the panels with which Foxglove shows and leads a robot. `wheelsight urdf`: a robot's
calibration from its URDF, and back.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from wheelsight.core.errors import ConfigError


def foxglove_layout() -> None:
    """Print a layout for Foxglove, which its menu imports: map, plan and surfels in 3D, image, plots, stick and STOP.

    Open the address that --foxglove of run, drive or serve prints as a Foxglove WebSocket.

    [bold]Examples[/bold]

    wheelsight foxglove-layout > layout.json
    """
    from wheelsight_export.bag import foxglove_layout as layout_of
    from wheelsight_export.topics import MAP, TOPICS

    live = [topic.name for topic in TOPICS.values() if topic.is_live]
    typer.echo(json.dumps(layout_of(live, MAP), indent=2))


def urdf(
    source: Annotated[
        Path, typer.Argument(metavar="FILE", help="A .urdf, or a calibration .yaml.", show_default=False)
    ],
    out: Annotated[Path, typer.Option(metavar="FILE", help="A calibration .yaml, or a .urdf.", show_default=False)],
    calibration: Annotated[
        list[Path] | None,
        typer.Option(
            metavar="FILE", help="Of the robot; the URDF's mounts and wheels replace its own.", show_default=False
        ),
    ] = None,
    base: Annotated[
        str | None, typer.Option(metavar="LINK", help="The robot's body.", show_default="base_footprint, base_link")
    ] = None,
    camera_link: Annotated[
        str | None, typer.Option(metavar="LINK", help="The depth camera.", show_default="by its name")
    ] = None,
    package: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=DIR", help="Where package://NAME lies, for STL meshes.", show_default=False),
    ] = None,
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Whose footprint the URDF gets.", show_default="its defaults")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite what is there.")] = False,
) -> None:
    """Make a robot's calibration from its URDF, or a URDF of its calibration.

    Of a URDF: where the camera sits, radii and track of the driven wheels, and the footprint, which is printed for
    config.yaml. Counts of encoders and the camera's lens are in no URDF. A written URDF shows the robot in RViz, with
    the frames of /tf and the joints of /joint_states.

    [bold]Examples[/bold]

    wheelsight urdf turtle.urdf --out robot.yaml
    wheelsight urdf chair.urdf --calibration old.yaml --package chair_description=src/chair_description --out robot.yaml
    wheelsight urdf robot.yaml --config config.yaml --out robot.urdf
    """
    from wheelsight.app.cli.options import check_out

    kinds = (source.suffix.lower(), out.suffix.lower())
    check_out(out, force)
    if kinds[0] in (".urdf", ".xml") and kinds[1] in (".yaml", ".yml"):
        if config is not None:
            raise ConfigError("--config is of a URDF that is written", fix="leave it out")
        _read(source, out, calibration or [], base, camera_link, package or [])
    elif kinds[0] in (".yaml", ".yml") and kinds[1] in (".urdf", ".xml"):
        if calibration or base or camera_link or package:
            raise ConfigError("--calibration, --base, --camera-link and --package are of a URDF that is read")
        _write(source, out, config)
    else:
        raise ConfigError(f"{source.name} to {out.name}", fix="a .urdf to a .yaml, or a .yaml to a .urdf")


def _read(
    source: Path, out: Path, under: list[Path], base: str | None, camera_link: str | None, package: list[str]
) -> None:
    from wheelsight.app.cli.console import print_warning
    from wheelsight.core.calibration import laid_over, read_layer, save_layer
    from wheelsight_ros2.urdf import robot_of_urdf

    packages = dict[str, Path]()
    for one in package:
        name, is_given, folder = one.partition("=")
        if not (name and is_given and folder):
            raise ConfigError(f"--package {one}", fix="NAME=DIR, such as chair_description=src/chair_description")
        packages[name] = Path(folder)
    robot = robot_of_urdf(source, base=base, camera=camera_link, packages=packages)
    for warning in robot.warnings:
        print_warning(warning)
    if robot.T_base_camera is None and robot.radii_m is None:
        raise ConfigError(f"{source} has neither a camera nor driven wheels", fix="--camera-link LINK")
    fields = dict[str, object]()
    for path in under:
        fields = laid_over(fields, read_layer(path))
    save_layer(laid_over(fields, robot.layer), out)
    if robot.T_base_camera is not None:
        x_m, y_m, z_m = robot.T_base_camera[:3, 3]
        typer.echo(f"camera {robot.camera}: {x_m:.3f} m ahead of the axle, {y_m:.3f} m left, {z_m:.3f} m high")
    if robot.radii_m is not None:
        sizes = f"radii {robot.radii_m[0]:.4f} and {robot.radii_m[1]:.4f} m, track {robot.track_m:.4f} m"
        typer.echo(f"wheels {', '.join(robot.wheels)}: {sizes}")
    if robot.outline is not None:
        names = zip(("front_m", "back_m", "width_m"), robot.outline, strict=True)
        inner = ", ".join(f"{name}: {value:.3f}" for name, value in names)
        typer.echo(f"for config.yaml: navigation: {{footprint: {{{inner}}}}}")


def _write(source: Path, out: Path, config: Path | None) -> None:
    from wheelsight.config import load_config
    from wheelsight.core.calibration import load_calibration
    from wheelsight.core.files import write_text
    from wheelsight_ros2.urdf import urdf_of

    footprint = load_config(config).navigation.footprint
    outline = (footprint.front_m, footprint.back_m, footprint.width_m)
    write_text(out, urdf_of(load_calibration(source), source.stem, outline))
    typer.echo(f"{out}: ros2 run robot_state_publisher robot_state_publisher {out}")
