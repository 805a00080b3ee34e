"""Planning stage: reads a scene, its materials and its light; writes ``plan.yaml``."""

from collections.abc import Sequence
from dataclasses import asdict

from irodori.config.models import ObjectShape, Render, Scene
from irodori.config.placed_names import object_names
from irodori.core.errors import InputError
from irodori.core.progress import LOGGER
from irodori.geometry.shapes.shape import Shape
from irodori.light.environment_file import Environment
from irodori.rendering.energy_gain import load_materials
from irodori.rendering.integrators import InteractiveRenderer, make_renderer
from irodori.rendering.planning.choices import choose
from irodori.rendering.planning.plan_file import document_of, rounded, write_plan
from irodori.rendering.planning.planned_picture import parts_of
from irodori.rendering.scene_arrays import make_placements, make_view, row_names
from irodori.rendering.scene_white import scene_white


def plan_scene(
    scene_name: str,
    scene: Scene,
    shapes: Sequence[ObjectShape],
    material_files: list,
    environment_file,
    *,
    options: Render,
    output,
    maps_file=None,
) -> None:
    """Decide which simplifications to make in a scene and write the plan to a file.

    Parameters
    ----------
    scene_name : str
    scene : Scene
        Scene with ``tolerance_ciede2000``.
    shapes : sequence of ObjectShape
        Shape of each object.
    material_files, environment_file : paths
    options : Render
    output : path
    maps_file : path, optional
        File of the scene's light maps; without one they are baked if its integrator uses them.

    Raises
    ------
    InputError
        If an override is not possible, a material reflects more light than falls on it, the scene has no light, or the
        integrator cannot keep the tolerance.
    """
    placed = [Shape.from_definition(shape) for shape in shapes]
    document = plan_of(
        scene_name,
        scene,
        placed,
        load_materials(scene, placed, material_files),
        Environment.load(environment_file),
        options,
        maps_file=maps_file,
        to_reference=True,
    )
    write_plan(output, document)
    LOGGER.info(
        "predicted %.3g ΔE2000 of %.3g; numbers a pixel %.3g of %.3g",
        document["predicted_delta_e"],
        document["tolerance_ciede2000"],
        *(document[key].get("numbers_per_pixel", 0.0) for key in ("cost", "cost_of_full_model")),
    )


def plan_of(
    scene_name: str,
    scene: Scene,
    shapes: list,
    materials: list,
    environment: Environment,
    options: Render,
    *,
    maps_file=None,
    to_reference: bool = False,
) -> dict:
    """Return the content of a scene's plan; parameters and errors are those of `plan_scene`.

    With ``to_reference``, the distance of the full model of the integrator `interactive` to the path-traced picture is
    subtracted from the tolerance first. Otherwise the tolerance refers to the full model.
    """
    if not scene_white(scene, environment)[0].any():
        found = "no light on a surface that faces up at the scene's origin"
        raise InputError(f"scene {scene_name}", "tolerance_ciede2000", found, "a white that colours are seen against")
    if scene.tolerance_ciede2000 is None:
        raise ValueError("a scene without tolerance_ciede2000; accepted: one with it")
    renderer = make_renderer(scene, shapes, materials, environment, options, maps_file=maps_file)
    placements = make_placements(scene, renderer.shapes)
    views = [make_view(view, scene.image) for view in scene.views.values()]
    if not isinstance(renderer, InteractiveRenderer):
        from irodori.rendering.planning.paths_per_pixel import plan_reference

        return plan_reference(scene_name, scene, placements, renderer.objects, environment, views=views)
    parts = parts_of(renderer)
    far = None
    if to_reference:
        from irodori.rendering.planning.attainable import refuse_unattainable

        far = refuse_unattainable(scene_name, scene, parts, placements, options.pixel_side)
    planner = choose(
        parts,
        [view.finer(options.pixel_side) for view in views],
        row_names(object_names(scene), parts.objects),
        scene.tolerance_ciede2000 - (far.p99 if far else 0.0),
        max_bounces=scene.max_bounces,
        overrides=scene.plan,
        where=f"scene {scene_name}",
    )
    document = document_of(scene_name, planner, options.pixel_side) | {"tolerance_ciede2000": scene.tolerance_ciede2000}
    if far:
        document["full_model_delta_e_to_reference"] = rounded(asdict(far))
    return document
