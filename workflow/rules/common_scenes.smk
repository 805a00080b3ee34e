#: Files that a scene may ask for beside the spectral EXR and the PNG of each view.
FURTHER_OUTPUTS = {"xyz-exr": "results/{scene}/{view}.xyz.exr", "tiff": "results/{scene}/{view}.tif"}


def scene_objects(wildcards):
    """Return the objects of a scene, in its order."""
    return [item["object"] for item in config["scenes"][wildcards.scene]["objects"]]


def scene_materials(pattern):
    """Return a function from wildcards to a file of every object of the scene."""
    return lambda wildcards: [pattern.format(object=name) for name in scene_objects(wildcards)]


def scene_environment(wildcards):
    """Return the file of a scene's light."""
    return f"results/environments/{config['scenes'][wildcards.scene]['environment']}.h5"


def scene_calibrations(wildcards):
    """Return the calibration of the camera that photographed each object of a scene."""
    cameras = [config["objects"][name]["camera"] for name in scene_objects(wildcards)]
    return [f"results/cameras/{camera}/calibration.h5" for camera in cameras]


def scene_tiles(wildcards, kind="brdf"):
    """Return the fitted tiles of a scene's objects, each object's once; or another kind of them."""
    size = config["rectify"]["tile_texels"]
    found = []
    for name in dict.fromkeys(scene_objects(wildcards)):
        texels = config["objects"][name]["texels"]
        count = len(tile_rows(texels["height"], texels["width"], size))
        found += [f"results/{name}/{kind}/tile-{number:03d}.h5" for number in range(count)]
    return found


def scene_observations(wildcards):
    """Return what the fitted tiles of a scene's objects were fitted to."""
    return scene_tiles(wildcards, "observations")


def scene_subjects(wildcards):
    """Return of each object of a scene its shape and the side of two mosaic pixels of its photographs on it, mm."""
    found = []
    for name in scene_objects(wildcards):
        definition = config["objects"][name]
        camera = config["cameras"][definition["camera"]]
        optics, rig = camera["optics"], config["rigs"][camera["rig"]]
        pixel_mm = optics["pixel_pitch_um"] / 1000.0 * rig["camera_distance_mm"] / optics["focal_length_mm"]
        found.append({"shape": definition["shape"], "sample_mm": 2.0 * pixel_mm})
    return found


def light_calibration(wildcards):
    """Return the calibration of the camera that photographed a scene's light, as a list; of other light there is none."""
    definition = config["environments"][config["scenes"][wildcards.scene]["environment"]]
    return [f"results/cameras/{definition['camera']}/calibration.h5"] if "camera" in definition else []


def scene_meshes(wildcards):
    """Return the files of the meshes among a scene's objects."""
    return meshes_of(*dict.fromkeys(scene_objects(wildcards)))


def scene_tables(wildcards):
    """Return the tables that a scene's own lights, bodies and frames are made of."""
    scene = config["scenes"][wildcards.scene]
    return named_tables(scene["lights"], scene["bodies"], scene.get("frames"))


def scene_with_frames(wildcards):
    """Return the definition of a scene that has frames."""
    scene = config["scenes"][wildcards.scene]
    if "frames" not in scene:
        raise WorkflowError(f"the scene {wildcards.scene} defines no frames, so there are none to render")
    return scene


def memory_of_frames(wildcards):
    """Return what the pictures of a sequence take, MB: they are joined in memory."""
    scene = scene_with_frames(wildcards)
    frames = scene["frames"]
    count = frames.get("count", len(frames.get("illuminants", [])) * (1 + frames.get("count_between", 0)))
    return 8 * scene["image"]["width"] * scene["image"]["height"] * count // 1_000_000


def scene_plan(wildcards):
    """Return the plan of a scene that tolerates an error, as a list; others are rendered in full."""
    tolerant = "tolerance_ciede2000" in config["scenes"][wildcards.scene]
    return [f"results/{wildcards.scene}/plan.yaml"] if tolerant else []


def scene_shapes(wildcards):
    """Return the shapes of a scene's objects."""
    return [config["objects"][name]["shape"] for name in scene_objects(wildcards)]


def follows_the_model(name):
    """Whether a virtual object's true materials are those of equation (5), which alone is rendered."""
    return all(material["kind"] == "paper" for material in config["objects"][name]["virtual"]["materials"])


def scene_views(virtual_only):
    """Yield scene, view and definition of every view, or of those whose objects' truth is known."""
    known = {name for name in virtual("objects") if follows_the_model(name)}
    for scene, definition in config["scenes"].items():
        if not virtual_only or known.issuperset(item["object"] for item in definition["objects"]):
            for view in definition["views"]:
                yield scene, view, definition


def views(pattern, virtual_only=False):
    """Return a pattern filled for every view of every scene, or of those whose objects' truth is known."""
    return [
        pattern.format(scene=scene, view=view, environment=definition["environment"])
        for scene, view, definition in scene_views(virtual_only)
    ]


def pictures(wildcards):
    """Return the pictures to make."""
    further = [
        FURTHER_OUTPUTS[kind].format(scene=scene, view=view)
        for scene, view, definition in scene_views(virtual_only=False)
        for kind in definition["further_outputs"]
    ]
    frames = [
        f"results/{scene}/{view}.frames.png"
        for scene, view, definition in scene_views(virtual_only=False)
        if "frames" in definition
    ]
    return views("results/{scene}/{view}.png") + views("results/{scene}/{view}.exr") + further + frames


def display_file(wildcards):
    """Return the file that says how a scene's display shows colours, as a list; a standard one needs none."""
    device = config["scenes"][wildcards.scene]["display"]["device"]
    return [device["file"]] if "file" in device else []


def view_scenes(virtual_only=False):
    """Return of each view of `views` what its scene's white follows from."""
    return [{key: definition[key] for key in ("lights", "display")} for _, _, definition in scene_views(virtual_only)]


def photographs(pattern):
    """Return a pattern filled for every photograph of a scene that its rendering is compared with."""
    return [
        pattern.format(scene=scene, photograph=photograph)
        for scene, definition in config["scenes"].items()
        for photograph in definition["photographs"]
    ]


def photograph_of(wildcards):
    """Return the definition of a photograph of a scene."""
    return config["scenes"][wildcards.scene]["photographs"][wildcards.photograph]


def photograph_camera(wildcards):
    """Return the definition of the camera of a photograph."""
    return config["cameras"][photograph_of(wildcards)["camera"]]


def is_photograph_virtual(wildcards):
    """Whether the photograph is computed."""
    return config["rigs"][photograph_camera(wildcards)["rig"]]["kind"] == "virtual"


def photograph_folder(wildcards):
    """Return the folder of a photograph's RAW files."""
    if is_photograph_virtual(wildcards):
        return f"results/{wildcards.scene}/photographs/{wildcards.photograph}/captures"
    captures = photograph_of(wildcards)["captures"]
    return captures.get("folder") or str(Path(captures["table"]).parent)


def photograph_table(wildcards):
    """Return the capture table of a photograph: the virtual camera's, or the user's own."""
    if is_photograph_virtual(wildcards):
        return f"{photograph_folder(wildcards)}/captures.csv"
    return photograph_of(wildcards)["captures"]["table"]


def photograph_made(wildcards):
    """Return the files that say that a photograph is there: the session's record, or the user's own files."""
    if is_photograph_virtual(wildcards):
        return [f"{photograph_folder(wildcards)}/session.json"]
    table, folder = photograph_table(wildcards), photograph_folder(wildcards)
    return [table, *(f"{folder}/{shot.file}" for shot in read_captures(table, folder) if shot.role == "scene")]


def photograph_radiance(wildcards):
    """Return what stood before a virtual camera, as a list; nobody knows it of a real one."""
    if not is_photograph_virtual(wildcards):
        return []
    return [f"results/{wildcards.scene}/photographs/{wildcards.photograph}/radiance.h5"]


def part_of_scene(*keys):
    """Return a function from wildcards to keys of a scene's definition; another key's change reruns nothing."""
    return lambda wildcards: {key: config["scenes"][wildcards.scene][key] for key in keys}


def of_photograph(pattern):
    """Return a function from wildcards to a file of the camera of a photograph."""
    return lambda wildcards: pattern.format(camera=photograph_of(wildcards)["camera"])


def true_light(wildcards):
    """Return the file of the light that really falls on a scene; of what no camera photographed it is what was given."""
    name = config["scenes"][wildcards.scene]["environment"]
    known = is_virtual(config, "environments", name)
    return f"results/environments/{name}/truth.h5" if known else f"results/environments/{name}.h5"
