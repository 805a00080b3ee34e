"""Definitions as dataclasses, one for each block of the schemas beside this module.

Written by ``python -m irodori.config.write_models``; change the schemas instead.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from irodori.config.definition import Definition


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Make(Definition):
    """What a run makes."""

    #: Names of the scenes to render; their objects, environments and cameras are made too.
    scenes: tuple[str, ...] = ()

    #: Names of cameras to calibrate besides those that the scenes need.
    cameras: tuple[str, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Ingest(Definition):
    """From RAW files to linear bands."""

    #: A pixel at or above this fraction of the range from black to white is not valid (ratio).
    saturation: float = 0.98

    #: How the mosaic becomes bands; superpixel interpolates nothing and gives half the resolution, the others are
    #: LibRaw's algorithms at full resolution.
    demosaic: Literal["superpixel", "linear", "vng", "ppg", "ahd", "dcb", "dht"] = "superpixel"

    #: Whether the shots without and with the filter are aligned (true or false).
    register: bool = True

    #: Largest residual of the registration, in superpixels; above it the capture is refused.
    max_registration_px: float = 0.3

    #: Largest deviation of the response per second over an exposure series (ratio); a camera is refused if it deviates
    #: more than this and more than repeated frames scatter.
    max_nonlinearity: float = 0.02

    #: Captures of an object that one job ingests, one after the other (count).
    captures_per_job: int = 8


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Placing(Definition):
    """How precisely the typed places of an object, its camera and its light are known, as standard deviations.

    The photographs then refine them. A quantity with 0 stays as typed.
    """

    #: Whether the photographs refine where objects lie (rule `register_object`); otherwise they lie as typed (true or
    #: false).
    register: bool = True

    #: Standard deviation of the object's place on the table along each axis, in mm.
    translation_mm: float = 2.0

    #: Standard deviation of the object's turn about each axis of the table, in degrees.
    rotation_deg: float = 1.0

    #: The same in a further placement, whose typed rotation is a rough one, in degrees.
    turned_deg: float = 5.0

    #: Standard deviation of the distance of the camera, in mm.
    camera_distance_mm: float = 30.0

    #: Standard deviation of the focal length, in percent.
    focal_length_percent: float = 3.0

    #: Standard deviation of the principal point along each side of the picture, in pixels of the sensor.
    principal_point_px: float = 2.0

    #: Standard deviation of an error that all camera angles share, and of each photograph's own error, in degrees.
    camera_deg: float = 0.05

    #: Standard deviation of an error that all light angles share, and of each photograph's own error, in degrees.
    light_deg: float = 0.05

    #: Largest root-mean-square distance between the object in one photograph and the place that the other photographs
    #: give it, in superpixels; above it the photograph is refused.
    max_residual_px: float = 1.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Rectify(Definition):
    """From pictures to observations of each texel."""

    #: Texels in one tile, the unit of work (count). Each job of a tile reads all photographs of the object once to
    #: check them, so that small tiles take longer; a core works on one tile at a time.
    tile_texels: int = 400000

    #: Observations lit or seen at a larger angle carry no weight in the fit, in degrees.
    max_angle_deg: float = 80.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FitBounds(Definition):
    """Smallest and largest value of each parameter."""

    #: Smallest and largest diffuse weight (ratio).
    alpha: tuple[float, float] = (0.0, 2.0)

    #: Smallest and largest gloss weight (ratio).
    beta: tuple[float, float] = (0.0, 10000.0)

    #: Smallest and largest roughness, in rad of the paper's lobe and in the unit of any other; what a lobe is not
    #: defined for is left out.
    mu_rad: tuple[float, float] = (0.005, 1.2)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Fit(Definition):
    """From observations to diffuse weight, gloss weight and roughness of each texel."""

    #: How the fit is computed; varpro is variable projection, nlopt calls NLopt's L-BFGS from a compiled loop.
    solver: Literal["varpro", "nlopt"] = "varpro"

    #: Relative error of an observation apart from noise, such as the drift of the light (ratio).
    model_error: float = 0.01

    #: Standard deviation of the angle of light or camera, in degrees; enters the standard errors. With auto, the errors
    #: are those that registration finds for each object, or 0.05 if objects are not registered.
    pose_error_deg: Literal["auto"] | float = "auto"

    #: Relative error that all observations of an object share, of the white reference's reflectance and of the lamp's
    #: level between the white reference and the object (ratio).
    level_error: float = 0.014

    #: Whether the lamp's level in every photograph is estimated jointly with the materials.
    level_by_photograph: bool = False

    #: Whether the texels of one paint share its gloss.
    gloss_by_paint: bool = True

    #: Smallest and largest value of each parameter.
    bounds: FitBounds = FitBounds()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Compress(Definition):
    """Compression of the reflectance maps."""

    #: Largest mean colour error, in CIEDE2000, under every light; as many bases are kept as it takes.
    target_delta_e_mean: float = 0.1

    #: 99th percentile of the colour error that it must keep under too, in CIEDE2000.
    target_delta_e_p99: float = 0.5

    #: The number of bases is a multiple of this (count), or the image's rank; 1 allows any number.
    align: int = 4

    #: Weights of the decomposition; nothing weighs all wavelengths alike, visual as the colour-matching functions and
    #: the lights do (no unit).
    weighting: Literal["nothing", "visual"] = "nothing"

    #: Precision of stored coefficients, 16 bits with a scale for each basis or 32 (no unit).
    storage: Literal["half", "single"] = "half"

    #: Lossless compression of the file; gzip, which every program reads, or LZF, which only h5py reads without a plugin
    #: (no unit).
    codec: Literal["gzip", "lzf"] = "gzip"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class IrradianceMap(Definition):
    """The irradiance map, which is as fine as its light needs."""

    #: Largest error of the look-up between the map's normals, relative to the largest irradiance (ratio); the map grows
    #: until its error is smaller.
    max_error: float = 0.002

    #: Rows at which the map stops growing all the same, in pixels; it has twice as many columns.
    max_height: int = 512


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class EnvironmentMaps(Definition):
    """Compression of the environment and its prepared maps."""

    #: Largest mean colour error, in CIEDE2000, under every light; as many bases are kept as it takes.
    target_delta_e_mean: float = 0.1

    #: 99th percentile of the colour error that it must keep under too, in CIEDE2000.
    target_delta_e_p99: float = 0.5

    #: The number of bases is a multiple of this (count), or the image's rank; 1 allows any number.
    align: int = 4

    #: Weights of the decomposition; nothing weighs all wavelengths alike, visual as the colour-matching functions and
    #: the lights do (no unit).
    weighting: Literal["nothing", "visual"] = "nothing"

    #: Precision of stored coefficients, 16 bits with a scale for each basis or 32 (no unit).
    storage: Literal["half", "single"] = "half"

    #: Lossless compression of the file; gzip, which every program reads, or LZF, which only h5py reads without a plugin
    #: (no unit).
    codec: Literal["gzip", "lzf"] = "gzip"

    #: Whether light blurred for rough reflection is stored too, for the integrator interactive (no unit).
    gloss_maps: bool = True

    #: The irradiance map, which is as fine as its light needs.
    irradiance: IrradianceMap = IrradianceMap()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Render(Definition):
    """From scene to picture."""

    #: Samples of the integrator interactive along each side of a pixel (count); 2 means four rays a pixel.
    pixel_side: int = 2

    #: A mirror path of the integrator interactive ends when it would add less than this part of the light that it meets
    #: (ratio).
    min_throughput: float = 0.001

    #: Rows of the picture between two reports of progress, in pixels; the picture is held whole, memory does not depend
    #: on it.
    tile_rows: int = 60

    #: Precision of the numbers in the spectral EXR, 16 bits or 32 (no unit); a picture that spans more than 16 bits
    #: hold is written with 32.
    storage: Literal["half", "single"] = "half"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ReportOptions(Definition):
    """What the reports compare."""

    #: Lights under which colour errors are computed.
    lights: tuple[str, ...] = ("D65", "A")


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Publication(Definition):
    """What `irodori crate` states about the data when they are published; it changes no result."""

    #: Licence of photographs and results; the address of its text, or its name (no unit). Without it the crate says
    #: that none was stated.
    licence: str | None = None

    #: Name of who took the photographs (no unit).
    photographer: str | None = None

    #: ORCID of that person, four groups of four digits with or without `https://orcid.org/` (no unit); its last digit
    #: is checked.
    photographer_orcid: str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Config(Definition):
    """What to make, and the parameters that every object shares."""

    #: Folder that holds objects/, scenes/, cameras/, environments/ and rigs/.
    definitions: str = "config"

    #: How much `snakemake benchmark` measures; small runs every stage and peer on small inputs in some minutes, full
    #: runs more variants on large inputs, for publication (no unit).
    benchmark_size: Literal["small", "full"] = "small"

    #: What a run makes.
    make: Make

    #: From RAW files to linear bands.
    ingest: Ingest = Ingest()

    #: How precisely the typed places of an object, its camera and its light are known, as standard deviations; the
    #: photographs then refine them. A quantity with 0 stays as typed.
    place: Placing = Placing()

    #: Whether linear pictures, observations and separate fits of texels stay on the disk. If not, each is removed as
    #: soon as no job of the run needs it any more, and made again if a later run does.
    keep_intermediate: bool = True

    #: Sets of objects that were photographed one after the other by one camera, while nobody moved, refocused or
    #: readjusted camera, lens or rig; what they tell of these is combined. Where one of a set is made, all are
    #: registered.
    photographed_together: tuple[tuple[str, ...], ...] = ()

    #: From pictures to observations of each texel.
    rectify: Rectify = Rectify()

    #: From observations to diffuse weight, gloss weight and roughness of each texel.
    fit: Fit = Fit()

    #: Compression of the reflectance maps.
    compress: Compress = Compress()

    #: Compression of the environment and its prepared maps.
    environment: EnvironmentMaps = EnvironmentMaps()

    #: From scene to picture.
    render: Render = Render()

    #: What the reports compare.
    report: ReportOptions = ReportOptions()

    #: What `irodori crate` states about the data when they are published; it changes no result.
    publication: Publication = Publication()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlateShape(Definition):
    """A flat rectangle on the table, its centre at the origin of the rig."""

    #: A flat rectangle on the table, its centre at the origin of the rig.
    kind: Literal["plate"] = "plate"

    #: Size along x, in mm.
    width_mm: float

    #: Size along y, in mm.
    height_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SphereShape(Definition):
    """A sphere, its centre at the origin of the rig."""

    #: A sphere, its centre at the origin of the rig.
    kind: Literal["sphere"] = "sphere"

    #: Radius, in mm.
    radius_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class MeshShape(Definition):
    """Triangles with UV coordinates, standing with their lowest point on the table."""

    #: Triangles with UV coordinates, standing with their lowest point on the table.
    kind: Literal["mesh"] = "mesh"

    #: Path of an OBJ, PLY, GLB or glTF whose UV coordinates put every place of the surface into one texture.
    file: str

    #: Unit of the file's coordinates.
    unit: Literal["mm", "cm", "m", "inch"]

    #: Axis of the file that points up; glTF has y.
    up: Literal["z", "y"] = "z"

    #: The point that stands at the origin of the rig, x, y, z, in mm, after unit and up; the middle of the bounding box
    #: where absent.
    pivot_mm: tuple[float, float, float] | None = None

    #: Where the file has no normals; facets that meet at a larger angle keep an edge, in degrees.
    crease_deg: float = 40.0


ObjectShape: TypeAlias = PlateShape | SphereShape | MeshShape


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Size(Definition):
    """Size of the object's maps, in texels; on a sphere longitude by latitude, on a mesh its UV atlas."""

    #: Width, in pixels.
    width: int

    #: Height, in pixels.
    height: int


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ConstantIndex(Definition):
    """Complex refractive index n + ik of the surface."""

    #: Real part, the same at every wavelength (ratio).
    n: float

    #: Imaginary part, the same at every wavelength (ratio).
    k: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class IndexTable(Definition):
    """Complex refractive index n + ik of the surface."""

    #: Path of a CSV with the columns wavelength_nm, n, k that covers 400 to 700 nm.
    file: str


RefractiveIndex: TypeAlias = ConstantIndex | IndexTable


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Sheet(Definition):
    """That the object is a thin sheet, such as a leaf, paper or textile, of which both sides are seen.

    For a plate, a disc or a mesh.
    """

    #: Assumed share of the light on one side that leaves the other side, evenly diffuse (ratio, or the name or path of
    #: a spectrum).
    transmittance: float | str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LevelPatch(Definition):
    """A flat matt patch, white or grey, that tells the lamp's level in every photograph of the object."""

    #: Centre of the patch's face (x, y, z from the rig's origin, as in the object's frame), in mm.
    centre_mm: tuple[float, float, float]

    #: Side of the square that is averaged, along x and y; somewhat smaller than the patch, in mm.
    side_mm: float

    #: Whether the patch turns and tilts with the table (true), or stands still beside it (false).
    moves_with_table: bool = True

    #: Reflectance factor of the patch in the green band. If given, the patch also tells how the lamp has changed since
    #: the white reference was photographed (ratio).
    reflectance_factor: float | None = None

    #: Relative standard error of the reflectance factor (ratio).
    reflectance_error: float = 0.01

    #: Relative departure of the patch from Lambert's law, as a standard deviation between directions of lamp and camera
    #: (ratio).
    departure: float = 0.01


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Markers(Definition):
    """The printed sheet of `irodori markers` on which the object is photographed.

    It tells where camera and table stood. It needs `place.register`.
    """

    #: Paper of the sheet.
    paper: Literal["A3", "A4", "A5", "A6", "letter"]

    #: Side of a square as printed; by default that of a print at full size, in mm.
    square_mm: float | None = None

    #: Height of the sheet in the object's frame; by default that of the object's lower side, in mm. Exact within
    #: `place.translation_mm`.
    z_mm: float | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FurtherPlacement(Definition):
    """One further placement."""

    #: Rotation of the object from how it lay first, about the table's x axis, then y, then z, in degrees; "[180, 0, 0]"
    #: turns it over.
    rotation_deg: tuple[float, float, float]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PoseGroup(Definition):
    """One group of poses."""

    #: Light angles from +z toward +x, in degrees.
    light_deg: tuple[float, ...]

    #: Camera angles from +z toward -x, in degrees.
    camera_deg: tuple[float, ...]

    #: Tilts of the table about y, towards the light, in degrees.
    tilt_deg: tuple[float, ...] = (0.0,)

    #: Turns of the table about its own axis, in degrees.
    turn_deg: tuple[float, ...] = (0.0,)

    #: Azimuths of the light about z, from +x towards +y, in degrees.
    light_azimuth_deg: tuple[float, ...] = (0.0,)

    #: Placements of the object that are photographed so (count); further ones are those of placements.
    placement: tuple[int, ...] = (1,)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PosePlan(Definition):
    """Expected surface for which `irodori plan` chooses poses; it does not change photographs or fit."""

    #: Smallest and largest diffuse weight expected (ratio).
    alpha: tuple[float, float] = (0.02, 0.9)

    #: Smallest and largest gloss weight expected (ratio).
    beta: tuple[float, float] = (0.5, 8.0)

    #: Smallest and largest roughness expected, in rad of the paper's lobe and in the unit of any other.
    mu_rad: tuple[float, float] = (0.05, 0.3)

    #: Poses to plan (count).
    count: int = 12

    #: Different places of the light and tilts that a person will set (count).
    max_manual: int = 3


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Exposures(Definition):
    """Exposure times for each state of the comb filter, in seconds. Several times make a bracket."""

    #: Exposure times with the comb filter out of the light path, in seconds.
    out: tuple[float, ...]

    #: Exposure times with the comb filter in the light path, in seconds.
    in_: tuple[float, ...] | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Captures(Definition):
    """The photographs of a real rig; needed where the rig is of kind files or driven."""

    #: Path of the CSV that lists the photographs, one a line.
    table: str

    #: Folder of the RAW files that the table names; the table's own folder where absent.
    folder: str | None = None

    #: Where the photographs can be fetched and on what terms; shown if one of them is missing.
    published: str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class UniformPattern(Definition):
    """The first material everywhere."""

    #: The first material everywhere.
    kind: Literal["uniform"] = "uniform"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ChecksPattern(Definition):
    """Rectangles of equal size that take the materials in turn."""

    #: Rectangles of equal size that take the materials in turn.
    kind: Literal["checks"] = "checks"

    #: Rectangles across the map (count).
    columns: int

    #: Rectangles down the map (count).
    rows: int


MaterialPattern: TypeAlias = UniformPattern | ChecksPattern


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FurtherGloss(Definition):
    """One gloss component."""

    #: Lobe of the gloss, as the object's lobes name it; gaussian is that of equation (5).
    lobe: str = "gaussian"

    #: Weight of the gloss term (ratio).
    beta: float

    #: Roughness, in rad of the paper's lobe and in the unit of any other.
    mu_rad: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ModelledMaterial(Definition):
    """Diffuse reflection and gloss of a registered lobe."""

    #: Diffuse reflection and gloss of a registered lobe.
    kind: Literal["modelled"] = "modelled"

    #: Diffuse reflectance factor; the name of a CIE test colour (TCS0 to TCS98) or the path of a file.
    spectrum: str

    #: Lobe of the gloss, as the object's lobes name it; gaussian is that of equation (5).
    lobe: str = "gaussian"

    #: Weight of the gloss term (ratio).
    beta: float

    #: Roughness, in rad of the paper's lobe and in the unit of any other.
    mu_rad: float

    #: A second gloss component, added to the first.
    further_gloss: tuple[FurtherGloss, ...] = ()

    #: Share of the light from behind that comes through, evenly diffuse (ratio, or the name or path of a spectrum).
    transmittance: float | str = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class MeasuredMaterial(Definition):
    """A table of measured reflection, diffuse and gloss together."""

    #: A table of measured reflection, diffuse and gloss together.
    kind: Literal["measured"] = "measured"

    #: Path of a CSV of theta_i_rad, phi_i_rad, theta_r_rad, phi_r_rad, then the BRDF in 1/sr at each wavelength in nm.
    file: str


TrueMaterial: TypeAlias = ModelledMaterial | MeasuredMaterial


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class VirtualObject(Definition):
    """What the virtual rig shows to its camera; needed where the rig is of kind virtual."""

    #: Coat of the true materials, as the object's coat names it.
    coat: Literal["sum", "coupled"] = "sum"

    #: How the materials are laid out over the object's map.
    pattern: MaterialPattern

    #: The true materials, row by row of the pattern, repeated where there are fewer than rectangles.
    materials: tuple[TrueMaterial, ...]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Object(Definition):
    """One object, what it is and how it is photographed."""

    #: What the object is, for people.
    description: str | None = None

    #: Name of the camera that photographs the object.
    camera: str

    #: Shape and size of the object.
    shape: ObjectShape

    #: Size of the object's maps, in texels; on a sphere longitude by latitude, on a mesh its UV atlas.
    texels: Size

    #: Complex refractive index n + ik of the surface.
    refractive_index: RefractiveIndex = ConstantIndex(n=1.5, k=0.0)

    #: Models of the rough gloss that the fit uses. With auto, it takes the simplest that predict left-out photographs
    #: within one standard error of the best. Of two, the second applies only where the data call for it.
    lobes: tuple[str, ...] = ("auto",)

    #: Whether the surface takes from the light of the diffuse ground what it reflects. With sum, diffuse light and
    #: gloss are added, as in equation (5). With coupled, the diffuse light passes the surface on its way in and out and
    #: is reduced at large angles by Fresnel's equations, by 5 % at 60° and all at grazing angles. With auto, the one
    #: that predicts left-out photographs better.
    coat: Literal["sum", "coupled", "auto"] = "sum"

    #: Weight of the mirror term, which reflects the surroundings (ratio).
    mirror_weight: float = 0.0

    #: That the object is a thin sheet, such as a leaf, paper or textile, of which both sides are seen; for a plate, a
    #: disc or a mesh.
    sheet: Sheet | None = None

    #: A flat matt patch, white or grey, that tells the lamp's level in every photograph of the object.
    level_patch: LevelPatch | None = None

    #: The printed sheet of `irodori markers` on which the object is photographed; it tells where camera and table
    #: stood. It needs `place.register`.
    markers: Markers | None = None

    #: Further placements in which the object is photographed, turned over or laid on its side; the first of them has
    #: the number 2. All photographs are put together on the object's one texture.
    placements: tuple[FurtherPlacement, ...] = ()

    #: Groups of poses that a session takes, on a virtual or a driven rig; a group stands for every combination of its
    #: lists.
    poses: tuple[PoseGroup, ...] | None = None

    #: Expected surface for which `irodori plan` chooses poses; it does not change photographs or fit.
    plan: PosePlan = PosePlan()

    #: Exposure times for each state of the comb filter, in seconds. Several times make a bracket.
    exposure_s: Exposures | None = None

    #: The photographs of a real rig; needed where the rig is of kind files or driven.
    captures: Captures | None = None

    #: What the virtual rig shows to its camera; needed where the rig is of kind virtual.
    virtual: VirtualObject | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class InteractiveIntegrator(Definition):
    """Look-ups in irradiance and blurred light, mirror reflections, hard shadows; nothing is sampled."""

    #: Look-ups in irradiance and blurred light, mirror reflections, hard shadows; nothing is sampled.
    kind: Literal["interactive"] = "interactive"

    #: Whether objects and bodies shade each other from the light of all directions and reflect light onto each other,
    #: which gloss shows too; a page that moves them has shadows alone (true or false).
    light_maps: bool = True

    #: Whether a sample at an outline, where another surface begins or a mesh bends, is the mean over what several rays
    #: meet (true or false).
    smooth_outlines: bool = True


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ReferenceIntegrator(Definition):
    """Paths that carry all bands and converge to the rendering equation; max_bounces is not read."""

    #: Paths that carry all bands and converge to the rendering equation; max_bounces is not read.
    kind: Literal["reference"] = "reference"

    #: Paths a pixel (count), a multiple of 8; powers of two are spread best.
    samples: int = 32

    #: Whether the noise is filtered out of the picture, at the price of a bias that is measured (true or false).
    denoise: bool = True

    #: Whether a coarse cache of the light on all surfaces ends paths after their first diffuse reflection, where none
    #: of it is seen; a small picture goes without, because filling takes time (true or false).
    cache: bool = True

    #: Standard error of a pixel over its radiance, both of the 7 x 7 pixels around it where nothing is denoised
    #: (share): where one has more, log and report say so.
    max_relative_standard_error: float = 1.0

    #: Seed of the random numbers (count).
    seed: int = 0


Integrator: TypeAlias = InteractiveIntegrator | ReferenceIntegrator


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlanOverrides(Definition):
    """Decisions that you make instead of the plan; needs tolerance_ciede2000."""

    #: Objects whose gloss is traced.
    gloss: tuple[str, ...] | None = None

    #: Objects whose mirror is traced.
    mirror: tuple[str, ...] | None = None

    #: Mirror reflections followed (count).
    max_bounces: int | None = None

    #: A path ends when it passes on less than this part of the light (ratio).
    least_throughput: float | None = None

    #: Basis vectors that represent the environment's spectra (count).
    light_bases: int | None = None

    #: How colour is carried along paths.
    representation: Literal["quadrature", "coefficients", "spectral"] | None = None

    #: Wavelengths of the representation quadrature (count).
    nodes: Literal[6, 14, 30] | None = None

    #: How often the environment's resolution is halved (count).
    environment_halvings: int | None = None

    #: How often the resolution of every texture is halved, down to two texels a side (count).
    texture_halvings: int | None = None

    #: Paths a pixel of the integrator reference (count), a multiple of 8.
    samples: int | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class DiscShape(Definition):
    """A flat disc that faces +z before it is turned; black behind unless a sheet."""

    #: A flat disc that faces +z before it is turned; black behind unless a sheet.
    kind: Literal["disc"] = "disc"

    #: Radius, in mm.
    radius_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlaneShape(Definition):
    """An endless plane, a floor unless it is turned; it faces +z before, and is black behind."""

    #: An endless plane, a floor unless it is turned; it faces +z before, and is black behind.
    kind: Literal["plane"] = "plane"


BodyShape: TypeAlias = DiscShape | PlaneShape | PlateShape | SphereShape


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class BodyMaterial(Definition):
    """Parameters of equation (5), the same all over the body."""

    #: Reflectance factor of the diffuse term; a CIE test colour (TCS0 to TCS98) or the path of a file.
    spectrum: str

    #: Gloss weight (ratio).
    beta: float = 0.0

    #: Roughness of the gloss, in rad.
    mu_rad: float = 0.1

    #: Mirror weight (ratio).
    mirror: float = 0.0

    #: Complex refractive index n + ik of the surface.
    refractive_index: RefractiveIndex = ConstantIndex(n=1.5, k=0.0)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Body(Definition):
    """One body in its place."""

    #: Shape and size of the body.
    shape: BodyShape

    #: Where the body's centre stands, x, y, z, in mm; of a plane any point of it.
    position_mm: tuple[float, float, float]

    #: Factor on the body's size (ratio); without effect on a plane.
    scale: float = 1.0

    #: Rotations about the scene's x, then y, then z axis, before the body is moved, in degrees.
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    #: Parameters of equation (5), the same all over the body.
    material: BodyMaterial

    #: Material of the back of a thin sheet, which is a plate, a disc or a mesh; by default that of its front.
    back: BodyMaterial | None = None

    #: Share of the light on one side of a thin sheet that leaves the other side, evenly diffuse (ratio, or the name or
    #: path of a spectrum).
    transmittance: float | str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CollimatedLight(Definition):
    """Parallel light from far away, with hard shadows."""

    #: Parallel light from far away, with hard shadows.
    kind: Literal["collimated"] = "collimated"

    #: Spectrum of the light; the name of a CIE illuminant or the path of a measured one.
    spectrum: str

    #: Direction that it comes from, from +x towards +y, in degrees.
    azimuth_deg: float

    #: That direction over the horizon, in degrees.
    elevation_deg: float

    #: Irradiance of a surface that faces the light (ratio; 1 gives a perfect diffuser radiance 1).
    irradiance: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RectangleLight(Definition):
    """A rectangle that shines along +z before it is turned, and is black behind."""

    #: A rectangle that shines along +z before it is turned, and is black behind.
    kind: Literal["rectangle"] = "rectangle"

    #: Spectrum of the light; the name of a CIE illuminant or the path of a measured one.
    spectrum: str

    #: Where the light's centre stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: Rotations about the scene's x, then y, then z axis, before it is moved, in degrees.
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    #: Size along x before it is turned, in mm.
    width_mm: float

    #: Size along y before it is turned, in mm.
    height_mm: float

    #: Radiance (ratio to the luminance of D65 as tabulated).
    radiance: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SphereLight(Definition):
    """A sphere that shines all around."""

    #: A sphere that shines all around.
    kind: Literal["sphere"] = "sphere"

    #: Spectrum of the light; the name of a CIE illuminant or the path of a measured one.
    spectrum: str

    #: Where the light's centre stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: Radius, in mm.
    radius_mm: float

    #: Radiance (ratio to the luminance of D65 as tabulated).
    radiance: float


SceneLight: TypeAlias = CollimatedLight | RectangleLight | SphereLight


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class StandardDisplay(Definition):
    """A display that follows a standard."""

    #: A display that follows a standard.
    kind: Literal["standard"] = "standard"

    #: The standard.
    name: Literal["sRGB", "Display P3", "Adobe RGB (1998)"]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SrgbTone(Definition):
    """The curve of sRGB, IEC 61966-2-1."""

    #: The curve of sRGB, IEC 61966-2-1.
    kind: Literal["srgb"] = "srgb"


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class GammaTone(Definition):
    """A power."""

    #: A power.
    kind: Literal["gamma"] = "gamma"

    #: Its exponent (ratio).
    gamma: float


ToneCurve: TypeAlias = SrgbTone | GammaTone


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PrimariesDisplay(Definition):
    """A display of stated primaries, white and tone curve."""

    #: A display of stated primaries, white and tone curve.
    kind: Literal["primaries"] = "primaries"

    #: CIE 1931 chromaticity of red, x, y (ratio).
    red_xy: tuple[float, float]

    #: CIE 1931 chromaticity of green, x, y (ratio).
    green_xy: tuple[float, float]

    #: CIE 1931 chromaticity of blue, x, y (ratio).
    blue_xy: tuple[float, float]

    #: CIE 1931 chromaticity of white, x, y (ratio).
    white_xy: tuple[float, float]

    #: Linear light of a code value, the same in all channels.
    tone: ToneCurve = SrgbTone()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class MeasuredDisplay(Definition):
    """A display that was measured on some patches of colour."""

    #: A display that was measured on some patches of colour.
    kind: Literal["measured"] = "measured"

    #: Path of a CSV with the columns red, green, blue, X, Y, Z, or of Argyll's .ti3.
    file: str


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ProfileDisplay(Definition):
    """A display that an ICC profile describes."""

    #: A display that an ICC profile describes.
    kind: Literal["profile"] = "profile"

    #: Path of an ICC profile of a matrix and tone curves.
    file: str


DisplayDevice: TypeAlias = StandardDisplay | PrimariesDisplay | MeasuredDisplay | ProfileDisplay


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class DisplayOptions(Definition):
    """How radiance becomes the displayed picture."""

    #: Factor on the radiance before the display (ratio), or auto.
    exposure: Literal["auto"] | float = "auto"

    #: The display for which PNG and TIFF are made.
    device: DisplayDevice = StandardDisplay(name="sRGB")


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Turntable(Definition):
    """One whole turn about a vertical axis, in equal steps."""

    #: One whole turn about a vertical axis, in equal steps.
    kind: Literal["turntable"] = "turntable"

    #: Frames of the turn (count).
    count: int

    #: What turns; objects and bodies in light that stays where it is, or the eye around them (a name).
    turned: Literal["objects", "eye"] = "objects"

    #: A point of the axis, x, y, z, in mm.
    pivot_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)

    #: Speed of the animated picture, in frames per second.
    frames_per_second: float = 10.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LightSweep(Definition):
    """Light that turns about the vertical axis through the scene's origin."""

    #: Light that turns about the vertical axis through the scene's origin.
    kind: Literal["light_sweep"] = "light_sweep"

    #: Frames, the first and the last angle included (count).
    count: int

    #: Whether the environment turns, the lights that stand in the scene, or both (a name).
    turned: Literal["environment", "lights", "both"]

    #: Angle of the first frame against the definition, from +x towards +y, in degrees.
    from_deg: float

    #: Angle of the last frame, in degrees.
    to_deg: float

    #: Speed of the animated picture, in frames per second.
    frames_per_second: float = 10.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class IlluminantChange(Definition):
    """All light is multiplied by a spectrum over another, both of one luminance."""

    #: All light is multiplied by a spectrum over another, both of one luminance.
    kind: Literal["illuminant_change"] = "illuminant_change"

    #: Illuminant of the scene as it is defined; the name of a CIE illuminant or the path of a measured one.
    from_illuminant: str

    #: Illuminants that light it after that, in this order.
    illuminants: tuple[str, ...]

    #: Frames between two illuminants, in which one fades into the next (count).
    count_between: int = 0

    #: White of the pictures; the first frame's for all frames, or each frame's own (a name).
    white: Literal["first", "each"] = "first"

    #: Speed of the animated picture, in frames per second.
    frames_per_second: float = 10.0


Frames: TypeAlias = Turntable | LightSweep | IlluminantChange


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonCamera(Definition):
    """Where the eye stands instead of a view."""

    #: The point in the middle of the picture, x, y, z, in mm.
    target_mm: tuple[float, float, float]

    #: Side of the eye as seen from the target, from +x towards +y, in degrees.
    azimuth_deg: float

    #: Height of the eye over the target's horizon, in degrees.
    elevation_deg: float

    #: From the eye to the target, in mm.
    distance_mm: float

    #: Vertical field of view, in degrees.
    fov_deg: float = 34.0

    #: Turn of the camera about its line of sight, counter-clockwise, in degrees.
    roll_deg: float = 0.0

    #: Height of what is seen by parallel rays, in mm; 0 for an eye in one point.
    height_mm: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class NamedIlluminant(Definition):
    """A published illuminant."""

    #: Name of a CIE illuminant (D65, A, LED-B3).
    name: str


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class TemperatureIlluminant(Definition):
    """Daylight or a black body of a colour temperature."""

    #: Correlated colour temperature; a black body under 4000, daylight from there on, in kelvin.
    cct_K: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class DrawnIlluminant(Definition):
    """A spectrum in numbers."""

    #: Spectral power at 400, 405, ... 700 nm (relative).
    power: tuple[float, ...]

    #: Name that the page shows.
    label: str = "drawn"


LessonIlluminant: TypeAlias = NamedIlluminant | TemperatureIlluminant | DrawnIlluminant


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonLamp(Definition):
    """One round lamp."""

    #: Where its centre stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: Diameter, in mm; a point where 0.
    size_mm: float = 60.0

    #: Light 500 mm away (ratio; 1 gives a white surface that faces the lamp there the luminance of D65 as tabulated).
    strength: float = 1.0

    #: Spectrum of the lamp; D65 where absent.
    illuminant: LessonIlluminant | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonLight(Definition):
    """The light of the step."""

    #: Name of the environment that lights the scene, which the page then holds too; the scene's own where absent.
    environment: str | None = None

    #: Turn of the room about the vertical axis, from +x towards +y, in degrees.
    turn_deg: float = 0.0

    #: Spectrum of the light; if absent, as captured.
    illuminant: LessonIlluminant | None = None

    #: Lamps beside the room; with the scene's own lights at most eight.
    lamps: tuple[LessonLamp, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonPose(Definition):
    """One object in its place."""

    #: Name of an object or body of the scene.
    name: str

    #: Where its centre stands, x, y, z, in mm; its own place where absent.
    position_mm: tuple[float, float, float] | None = None

    #: Rotations about the scene's x, then y, then z axis, in degrees; its own where absent.
    turn_deg: tuple[float, float, float] | None = None

    #: Whether it is there (true or false).
    visible: bool = True


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonComparison(Definition):
    """What the picture is compared with; nothing if absent."""

    #: A second light beside the first, their colour difference, the metamerism between them, or the same light as a
    #: renderer of red, green and blue shows it.
    mode: Literal["wipe", "difference", "metamerism", "rgb"]

    #: Where the comparison begins, as a part of the width from the left (ratio).
    at: float = 0.5

    #: The second light.
    light: LessonLight = LessonLight()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonNote(Definition):
    """One note."""

    #: The point that the note is pinned to, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: The note in each language, by the language's code.
    text: Mapping[str, str] = field(hash=False)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LessonStep(Definition):
    """One step."""

    #: Heading of the step in each language, by the language's code.
    title: Mapping[str, str] = field(hash=False)

    #: What the learner reads in each language, by the language's code; an empty line parts paragraphs.
    text: Mapping[str, str] = field(hash=False)

    #: Path of a picture shown beside the text, PNG or JPEG of at most one megabyte.
    picture: str | None = None

    #: Name of the view that is seen; without it and camera, the first.
    view: str | None = None

    #: Where the eye stands instead of a view.
    camera: LessonCamera | None = None

    #: The light of the step.
    light: LessonLight = LessonLight()

    #: Objects that this step moves, turns or hides.
    objects: tuple[LessonPose, ...] = ()

    #: What the picture is compared with; nothing if absent.
    compare: LessonComparison | None = None

    #: Name of the observer whose colour matching counts.
    observer: Literal["CIE 1931 2°", "CIE 1964 10°", "CIE 2015 2°", "CIE 2015 10°"] | None = None

    #: Colour vision deficiency that is simulated.
    deficiency: Literal["protan", "deutan", "tritan"] | None = None

    #: What is laid over the picture.
    overlay: Literal["status", "uncertainty", "gamut"] | None = None

    #: Exposure relative to that with which the page opens (stops).
    exposure_ev: float = 0.0

    #: Numbered notes pinned to points of the scene.
    notes: tuple[LessonNote, ...] = ()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Lesson(Definition):
    """Guided steps that the classroom page shows beside the scene; none if left out."""

    #: A text in each language, by the language's code.
    title: Mapping[str, str] = field(hash=False)

    #: The steps in their order; each lists everything that differs from the state in which the page opens.
    steps: tuple[LessonStep, ...]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Lens(Definition):
    """A thin lens in the eye's place, for the integrator reference; without it all is in focus."""

    #: Diameter of the aperture, in mm.
    diameter_mm: float

    #: Distance of the plane in focus along the line of sight, in mm.
    focus_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PerspectiveView(Definition):
    """Everything is seen from one point, or through a lens about it."""

    #: Everything is seen from one point, or through a lens about it.
    kind: Literal["perspective"] = "perspective"

    #: Where the eye stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: The point in the middle of the picture, x, y, z, in mm.
    target_mm: tuple[float, float, float]

    #: Direction that points up in the picture (ratio, any length).
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    #: Vertical field of view, from the lower to the upper edge of the picture, in degrees.
    field_of_view_deg: float

    #: A thin lens in the eye's place, for the integrator reference; without it all is in focus.
    lens: Lens | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class OrthographicView(Definition):
    """Parallel rays: sizes do not change with the distance."""

    #: Parallel rays: sizes do not change with the distance.
    kind: Literal["orthographic"] = "orthographic"

    #: The middle of the plane where the rays start, x, y, z, in mm; what lies behind it is not seen.
    position_mm: tuple[float, float, float]

    #: The point in the middle of the picture, x, y, z, in mm.
    target_mm: tuple[float, float, float]

    #: Direction that points up in the picture (ratio, any length).
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    #: Height of what the picture shows, from its lower to its upper edge, in mm.
    height_mm: float


View: TypeAlias = PerspectiveView | OrthographicView


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ScenePhotograph(Definition):
    """One photograph, taken with the lens and the focal length of the camera's file."""

    #: Name of the camera that took it, whose calibration makes spectra of it.
    camera: str

    #: Where the centre of projection stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: A point on the axis of the lens, x, y, z, in mm.
    target_mm: tuple[float, float, float]

    #: Direction that points up in the picture (ratio, any length).
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)

    #: Table and folder of the RAW files, of the role scene; unless the rig is virtual.
    captures: Captures | None = None

    #: Virtual rig: exposure times of each filter state, in seconds.
    exposure_s: Exposures | None = None

    #: Superpixels along the side of a pixel of the comparison (count).
    block: int = 3

    #: Paths for each superpixel (count), of the rendering and of what a virtual camera sees.
    samples: int = 16

    #: First of four seeds of the random numbers (count).
    seed: int = 0

    #: Factor on the photograph (ratio), or auto, which makes the median ratio of its luminance to the rendering's 1.
    scale: Literal["auto"] | float = 1.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlacedObject(Definition):
    """One object in its place."""

    #: Name of the object.
    object: str

    #: Where the object's centre stands, x, y, z, in mm.
    position_mm: tuple[float, float, float]

    #: Factor on the object's size (ratio).
    scale: float = 1.0

    #: Rotations about the scene's x, then y, then z axis, before the object is moved, in degrees.
    rotation_deg: tuple[float, float, float] = (0.0, 0.0, 0.0)

    #: Name of the object whose material covers the back, which makes a plate, a disc or a mesh a sheet.
    back: str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Scene(Definition):
    """One scene, objects in an environment seen from one side or several. World frame right-handed, z up, mm."""

    #: What the scene shows, for people.
    description: str | None = None

    #: Name of the environment that lights the scene.
    environment: str

    #: Size of the rendered picture, in pixels.
    image: Size

    #: Mirror reflections that the integrator interactive follows from object to object (count).
    max_bounces: int = 5

    #: Whether materials may send back more light than reaches them (true or false); if false, a scene with such a
    #: material is refused.
    allow_energy_gain: bool = False

    #: How the picture is computed.
    integrator: Integrator = ReferenceIntegrator()

    #: Colour error that 99 of 100 pixels of objects may have to path tracing (CIEDE2000); a plan is made within it.
    #: Everything is modelled where absent.
    tolerance_ciede2000: float | None = None

    #: Decisions that you make instead of the plan; needs tolerance_ciede2000.
    plan: PlanOverrides = PlanOverrides()

    #: Shapes of one material that stand beside the objects and were never photographed.
    bodies: tuple[Body, ...] = ()

    #: Lights that stand in the scene beside its environment; for the integrator reference, collimated ones for
    #: interactive too.
    lights: tuple[SceneLight, ...] = ()

    #: How radiance becomes the displayed picture.
    display: DisplayOptions = DisplayOptions()

    #: Files of each view beside the spectral EXR and the PNG, which are always made.
    further_outputs: tuple[Literal["xyz-exr", "tiff"], ...] = ()

    #: A sequence of frames of every view, beside its picture; none where this is left out.
    frames: Frames | None = None

    #: Guided steps that the classroom page shows beside the scene; none if left out.
    lesson: Lesson | None = None

    #: The sides from which the scene is rendered, by name.
    views: Mapping[str, View] = field(hash=False)

    #: Photographs of the scene that no material was fitted to, by name; each is compared with its view rendered.
    photographs: Mapping[str, ScenePhotograph] = field(default_factory=dict, hash=False)

    #: The objects of the scene.
    objects: tuple[PlacedObject, ...]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Distortion(Definition):
    """Distortion of the lens in the coefficients of OpenCV, over coordinates at unit distance.

    None where absent. It must not fold inside the picture.
    """

    #: Coefficient of OpenCV's model (ratio).
    k1: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    k2: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    p1: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    p2: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    k3: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    k4: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    k5: float = 0.0

    #: Coefficient of OpenCV's model (ratio).
    k6: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Optics(Definition):
    """Geometry of the picture; needed where the camera photographs objects."""

    #: Focal length, in mm.
    focal_length_mm: float

    #: Distance from one mosaic pixel to the next, in micrometres.
    pixel_pitch_um: float

    #: Width of the RAW picture, in mosaic pixels.
    width_px: int

    #: Height of the RAW picture, in mosaic pixels.
    height_px: int

    #: Where the optical axis meets the picture, x then y, in mosaic pixels.
    principal_point_px: tuple[float, float]

    #: Angle by which the camera is mounted on the rig turned about its line of sight, counter-clockwise seen from
    #: behind it, in degrees: 180 is upside down, 90 and 270 on its side.
    roll_deg: Literal[0, 90, 180, 270] = 0

    #: Distortion of the lens in the coefficients of OpenCV, over coordinates at unit distance; none where absent. It
    #: must not fold inside the picture.
    distortion: Distortion | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class WhiteReference(Definition):
    """The white reference photographed in place of the object.

    None where absent. A session needs one, and so does a camera that photographs objects or environments.
    """

    #: Reflectance factor of the white reference, a number or its measured spectrum (ratio, 1 = perfect diffuser).
    reflectance_factor: float | str


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class ChartCorners(Definition):
    """Centres of the four corner patches, x then y, in superpixels of 2 x 2 mosaic pixels.

    Needed unless find is chart, and not given with it.
    """

    #: Centre of the first patch of the first row, x then y, in superpixels.
    first: tuple[float, float]

    #: Centre of the last patch of the first row, x then y, in superpixels.
    row_end: tuple[float, float]

    #: Centre of the first patch of the last row, x then y, in superpixels.
    column_end: tuple[float, float]

    #: Centre of the last patch of the last row, x then y, in superpixels.
    last: tuple[float, float]


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Chart(Definition):
    """The colour chart that calibrates the camera; where there are several, the first."""

    #: Reflectance factors of the patches, row by row; the name of a published chart (BabelColor Average) or the path of
    #: a CSV.
    spectra: str

    #: Rows of patches (count).
    rows: int

    #: Columns of patches (count).
    columns: int

    #: How the patches are found in the photograph; nothing takes centres_px as they are, edges fits the grid to the
    #: patches' edges near centres_px, chart finds a ColorChecker without centres_px, a Classic of 4 x 6 patches or a
    #: Digital SG of 14 x 10 (letter by letter) or 10 x 14.
    find: Literal["nothing", "edges", "chart"] = "nothing"

    #: Centres of the four corner patches, x then y, in superpixels of 2 x 2 mosaic pixels; needed unless find is chart,
    #: and not given with it.
    centres_px: ChartCorners | None = None

    #: Side of the square that is averaged in each patch, in superpixels; needed where find is nothing, else half of a
    #: patch's side where absent.
    patch_px: int | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CalibrationOptions(Definition):
    """How spectra are recovered from responses."""

    #: How spectra are found from responses; pinv is the pseudo-inverse of the paper, ridge its damped form, wiener
    #: knows the noise and the chart's reflectances, local a Wiener estimator for every neighbourhood of colours, kernel
    #: a regression in polynomials of the response, broad the same for objects that are no paint; auto takes broad
    #: unless another is far better in cross-validation.
    estimator: Literal["pinv", "ridge", "wiener", "local", "kernel", "broad", "auto"] = "auto"

    #: Principal vectors of the chart's spectra that are kept (count), with pinv no more than the camera has bands; auto
    #: takes the best of 3 to 8, 10 and 12 in cross-validation. Where absent, auto with estimator auto, else as many as
    #: the camera has bands.
    bases: int | Literal["auto"] | None = None

    #: Number of photographs whose mean gives a recovered reflectance (count); the estimators assume that a pixel's
    #: noise variance is divided by it.
    texel_photographs: int = 16

    #: Largest condition number of the chart's responses, every band divided by its largest patch (ratio).
    max_condition: float = 100000.0

    #: Largest standard deviation of the recovered reflectance, root mean square over wavelengths, over that of a band's
    #: noise in units of the chart's largest response (ratio).
    max_noise_amplification: float = 100.0

    #: Largest mean error of the chart's patches when each is left out in turn (CIEDE2000 under the first of
    #: report.lights); a chart beyond is refused.
    max_leave_one_out_error: float = 10.0

    #: Largest difference of a band's level between the chart and the white reference (ratio); a chart beyond is
    #: refused, and a third of it is warned of.
    max_level_difference: float = 0.1


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class GivenFilter(Definition):
    """What is known of the filter of the second photograph; none where absent."""

    #: The path of a file of spectra with the transmittance of the filter (ratio) over 400 to 700 nm at least.
    transmittance: str

    #: Which spectrum of the file; needed where it holds several.
    name: str | None = None

    #: By how much the filter is expected to be shifted from its table (one standard deviation), in nm.
    shift_nm: float = 2.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class GivenSensitivities(Definition):
    """What is known of the sensitivities of red, green and blue; nothing where absent."""

    #: The name of a published camera or the path of a CSV, relative values.
    file: str

    #: By how much a sensitivity is expected to be off (one standard deviation), in percent of what the band has within
    #: some 20 nm.
    error_percent: float = 10.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RigPose(Definition):
    """Pose for the colour chart."""

    #: Light angle from +z toward +x, in degrees.
    light_deg: float

    #: Camera angle from +z toward -x, in degrees.
    camera_deg: float

    #: Tilt of the table about y, towards the light, in degrees.
    tilt_deg: float = 0.0

    #: Turn of the table about its own axis, in degrees.
    turn_deg: float = 0.0

    #: Azimuth of the light about z, from +x towards +y, in degrees.
    light_azimuth_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CameraPoses(Definition):
    """Where the rig stands for the camera's own photographs; the light falls on the sample at 0 to below 80 degrees."""

    #: Pose for the colour chart.
    chart: RigPose

    #: Pose for the white reference; needed where white is given.
    white: RigPose | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CameraDriver(Definition):
    """How the real camera is driven at the bench; none where absent."""

    #: Driver; gphoto2 is libgphoto2 through python-gphoto2, requirements-rig.txt.
    kind: Literal["gphoto2"]

    #: Name of the camera as libgphoto2 writes it, such as Canon EOS 40D (PTP mode).
    model: str

    #: Port of the camera, such as usb:001,004; detected where only one camera of the model is connected.
    port: str | None = None

    #: Sensitivity (ISO speed).
    iso: float

    #: Aperture; a number that the camera is set to (ratio), or manual for a lens with a ring.
    f_number: float | Literal["manual"]

    #: White balance, one of the camera's own choices; RAW values do not depend on it.
    white_balance: str = "Daylight"

    #: File format, the camera's own choice that is RAW.
    image_format: str = "RAW"

    #: Time that a photograph may take beyond its exposure, repetitions included, in seconds.
    deadline_s: float = 30.0

    #: Repetitions of what a busy camera or a lost line refused (count).
    retries: int = 5


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Passband(Definition):
    """One passband."""

    #: Wavelength of the middle, in nm.
    centre_nm: float

    #: Full width at half maximum, in nm.
    width_nm: float

    #: Largest transmittance (ratio).
    peak: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CombFilter(Definition):
    """The comb filter that splits red, green and blue into six bands."""

    #: The parts of the spectrum that pass.
    passbands: tuple[Passband, ...]

    #: Transmittance between the passbands (ratio).
    floor: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SensorOptions(Definition):
    """The sensor and its noise."""

    #: Charge at saturation, in electrons.
    full_well_e: float

    #: Standard deviation of the read noise, in electrons.
    read_noise_e: float

    #: Dark current, in electrons a second.
    dark_current_e_per_s: float

    #: RAW value without light (RAW counts).
    black_level: int

    #: Depth of the RAW values, in bits.
    bits: int

    #: Camera response that just saturates at base_exposure_s (ratio, 1 = perfect diffuser).
    response_at_full_well: float

    #: Exposure time for which response_at_full_well holds, in seconds.
    base_exposure_s: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class VirtualCameraOptions(Definition):
    """The camera inside the virtual rig; needed where the rig is of kind virtual."""

    #: Spectral sensitivities of red, green and blue; the name of a published camera or the path of a CSV.
    sensitivities: str

    #: The comb filter that splits red, green and blue into six bands.
    comb_filter: CombFilter

    #: The sensor and its noise.
    sensor: SensorOptions

    #: Sensitivity that the files state (ISO 12232); it changes nothing else.
    iso: float = 100.0

    #: Relative aperture that the files state (ratio of focal length to diameter); it changes nothing else.
    f_number: float = 8.0

    #: Width of every colour chart over its columns of patches, half a gap on either side included, in mm.
    chart_width_mm: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Camera(Definition):
    """One camera, how it is built and how it is calibrated."""

    #: What the camera is, for people.
    description: str | None = None

    #: Name of the rig that carries the camera.
    rig: str

    #: Geometry of the picture; needed where the camera photographs objects.
    optics: Optics | None = None

    #: The white reference photographed in place of the object; none where absent. A session needs one, and so does a
    #: camera that photographs objects or environments.
    white: WhiteReference | None = None

    #: The colour chart that calibrates the camera; where there are several, the first.
    chart: Chart

    #: Further colour charts by name, photographed in the pose and under the light of the first; a photograph of NAME
    #: has the role chart-NAME in the table. The calibration is trained on the patches of all.
    further_charts: Mapping[str, Chart] = field(default_factory=dict, hash=False)

    #: How spectra are recovered from responses.
    calibration: CalibrationOptions = CalibrationOptions()

    #: What is known of the filter of the second photograph; none where absent.
    comb_filter: GivenFilter | None = None

    #: What is known of the sensitivities of red, green and blue; nothing where absent.
    sensitivities: GivenSensitivities | None = None

    #: Where the rig stands for the camera's own photographs; the light falls on the sample at 0 to below 80 degrees.
    poses: CameraPoses | None = None

    #: Exposure times for each state of the comb filter, in seconds. Several times make a bracket.
    exposure_s: Exposures | None = None

    #: Photographs with the lens covered that a session takes at every exposure time (count); 0 where absent.
    dark_frames: int | None = None

    #: Photographs of the white reference that a session takes at every exposure time (count); 2 where absent, two or
    #: more measure the noise.
    white_frames: int | None = None

    #: Further exposure times of the white reference without the comb filter, which show whether the camera is linear,
    #: in seconds; none where absent.
    linearity_exposure_s: tuple[float, ...] | None = None

    #: The photographs of a real rig; needed where the rig is of kind files or driven.
    captures: Captures | None = None

    #: How the real camera is driven at the bench; none where absent.
    driver: CameraDriver | None = None

    #: The camera inside the virtual rig; needed where the rig is of kind virtual.
    virtual: VirtualCameraOptions | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class CapturesSource(Definition):
    """Photographs of every direction, longitude by latitude; clockwise, the zenith on top."""

    #: Photographs of every direction, longitude by latitude; clockwise, the zenith on top.
    kind: Literal["captures"] = "captures"

    #: Azimuth of the middle of the panorama, in degrees.
    centre_azimuth_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class MirrorBallSource(Definition):
    """Photographs of a mirror ball by a camera far away."""

    #: Photographs of a mirror ball by a camera far away.
    kind: Literal["mirror_ball"] = "mirror_ball"

    #: Centre of the ball in the photograph, x then y, in pixels of the linear picture (superpixels).
    centre_px: tuple[float, float]

    #: Radius of the ball in the photograph, in pixels of the linear picture (superpixels).
    radius_px: float

    #: Azimuth of the direction from the ball to the camera, in degrees.
    camera_azimuth_deg: float = 0.0

    #: Elevation of that direction over the horizon, in degrees.
    camera_elevation_deg: float = 0.0

    #: Turn of the camera about its line of sight, counter-clockwise seen from behind it, in degrees.
    roll_deg: float = 0.0

    #: Complex refractive index n + ik of the ball, whose Fresnel reflectance is divided out.
    refractive_index: RefractiveIndex | None = None

    #: Reflectance of the ball, the same at all angles, instead of its refractive index (ratio).
    reflectance_factor: float | str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RgbSource(Definition):
    """A panorama of high dynamic range, EXR or Radiance HDR, in linear sRGB."""

    #: A panorama of high dynamic range, EXR or Radiance HDR, in linear sRGB.
    kind: Literal["rgb"] = "rgb"

    #: Path of the panorama; clockwise, the zenith on top.
    file: str

    #: Factor on the file's radiance (ratio); radiance 1 of RGB has the luminance of D65 as tabulated.
    scale: float = 1.0

    #: Azimuth of the middle of the panorama, in degrees.
    centre_azimuth_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SpectralSource(Definition):
    """A spectral EXR panorama in the published layout, of any wavelengths."""

    #: A spectral EXR panorama in the published layout, of any wavelengths.
    kind: Literal["spectral"] = "spectral"

    #: Path of the panorama; clockwise, the zenith on top.
    file: str

    #: Factor on the file's radiance (ratio); radiance 1 of RGB has the luminance of D65 as tabulated.
    scale: float = 1.0

    #: Azimuth of the middle of the panorama, in degrees.
    centre_azimuth_deg: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlacedLight(Definition):
    """One light, a disc; either radiance or irradiance is given."""

    #: Spectrum of the light; the name of a CIE illuminant or the path of a measured one.
    spectrum: str

    #: Direction from +x towards +y, in degrees.
    azimuth_deg: float

    #: Direction over the horizon, in degrees.
    elevation_deg: float

    #: Angular diameter, in degrees; a disc smaller than a pixel becomes the four pixels around its middle, with the
    #: same energy and mean direction.
    diameter_deg: float = 0.0

    #: Radiance of the disc (ratio to the luminance of D65 as tabulated).
    radiance: float | None = None

    #: Irradiance of a surface that faces the light (ratio; 1 gives a perfect diffuser radiance 1).
    irradiance: float | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LightsSource(Definition):
    """Lights of known spectrum placed in directions; all else is dark."""

    #: Lights of known spectrum placed in directions; all else is dark.
    kind: Literal["lights"] = "lights"

    #: The lights.
    lights: tuple[PlacedLight, ...]


EnvironmentSource: TypeAlias = CapturesSource | MirrorBallSource | RgbSource | SpectralSource | LightsSource


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RoomSize(Definition):
    """Inside of the room, in m."""

    #: Size along x, in m.
    width: float

    #: Size along y, in m.
    depth: float

    #: Size along z, in m.
    height: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RoomSurface(Definition):
    """One surface, lit by ambient_light."""

    #: Reflectance factor; the name of a CIE test colour (TCS0 to TCS98) or the path of a file.
    spectrum: str

    #: Irradiance of the surface (ratio to the rig's light on a white facing it).
    irradiance: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RoomSurfaces(Definition):
    """What the room is covered with. Radiances are relative to a perfect diffuser under the rig's light."""

    #: One surface, lit by ambient_light.
    ceiling: RoomSurface

    #: One surface, lit by ambient_light.
    floor: RoomSurface

    #: One surface, lit by ambient_light.
    walls: RoomSurface

    #: One surface, lit by ambient_light.
    board: RoomSurface


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RoomWindow(Definition):
    """The wall of windows."""

    #: Light through the window; the name of a CIE illuminant or the path of a file.
    spectrum: str

    #: Radiance (ratio to a perfect diffuser under the rig's light).
    radiance: float

    #: Panes side by side (count).
    columns: int


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PlacedChart(Definition):
    """One chart's place."""

    #: Its middle, x, y, z from the centre of the floor, in m.
    position_m: tuple[float, float, float]

    #: Direction that it faces, x, y, z (a vector of any length above 0).
    facing: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RoomLamps(Definition):
    """The panels in the ceiling."""

    #: Light of the panels; the name of a CIE illuminant or the path of a file.
    spectrum: str

    #: Radiance (ratio to a perfect diffuser under the rig's light).
    radiance: float

    #: Rows of panels along y (count).
    rows: int

    #: Panels in a row, along x (count).
    columns: int

    #: Size of a panel along x, in m.
    width_m: float

    #: Size of a panel along y, in m.
    depth_m: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class VirtualRoom(Definition):
    """The room that the virtual rig photographs; needed where the camera's rig is of kind virtual."""

    #: Inside of the room, in m.
    room_m: RoomSize

    #: Where the camera stands, x, y, z from the centre of the floor, in m.
    eye_m: tuple[float, float, float]

    #: What the room is covered with. Radiances are relative to a perfect diffuser under the rig's light.
    surfaces: RoomSurfaces

    #: Light on the surfaces; the name of a CIE illuminant or the path of a file.
    ambient_light: str

    #: The wall of windows.
    window: RoomWindow

    #: Where each of room_charts stands.
    charts: Mapping[str, PlacedChart] = field(default_factory=dict, hash=False)

    #: The panels in the ceiling.
    lamps: RoomLamps


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class EnvironmentDefinition(Definition):
    """One environment, the light that comes from every direction of a place."""

    #: What the place is, for people.
    description: str | None = None

    #: Name of the camera that photographs the place; needed for the sources captures and mirror_ball.
    camera: str | None = None

    #: Size of the omnidirectional picture, in pixels; longitude by latitude. Needed for the sources captures,
    #: mirror_ball and lights; files bring their own.
    image: Size | None = None

    #: Where the light comes from.
    source: EnvironmentSource = CapturesSource()

    #: Exposure times for each state of the comb filter, in seconds. Several times make a bracket.
    exposure_s: Exposures | None = None

    #: The photographs of a real rig; needed where the rig is of kind files or driven.
    captures: Captures | None = None

    #: Colour charts by name, photographed in the place under its own light with the camera that takes the panorama; a
    #: photograph of NAME has the role room-chart-NAME in the table. Their patches tell the spectra of the place's
    #: lamps.
    room_charts: Mapping[str, Chart] = field(default_factory=dict, hash=False)

    #: All lamps of the place where they are known, the name of a CIE illuminant (FL11, D65, LED-B3) or the path of a
    #: measured spectrum each. The light is recovered as theirs on surfaces, in place of any published lamp's; a
    #: panorama that other lamps explain far better is refused.
    lamps: tuple[str, ...] = ()

    #: By how much each of the lamps may differ from its spectrum (one standard deviation), in percent; where absent, 5
    #: of a named lamp and 2 of a measured one.
    lamps_error_percent: float | None = None

    #: The room that the virtual rig photographs; needed where the camera's rig is of kind virtual.
    virtual: VirtualRoom | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class AxisLimit(Definition):
    """Light angle from +z toward +x, in degrees."""

    #: Smallest angle, in degrees.
    min: float

    #: Largest angle, in degrees.
    max: float

    #: Step of the axis, counted from min, in degrees.
    step: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RigLimits(Definition):
    """What each axis can reach, in degrees."""

    #: Light angle from +z toward +x, in degrees.
    light_deg: AxisLimit

    #: Camera angle from +z toward -x, in degrees.
    camera_deg: AxisLimit

    #: Tilt of the table about y, towards the light, in degrees.
    tilt_deg: AxisLimit

    #: Turn of the table about its own axis, in degrees.
    turn_deg: AxisLimit

    #: Azimuth of the light about z, from +x towards +y, in degrees, as under a dome or with a lamp in the hand; where
    #: absent the light stands in the rig's plane. Not for driven rigs.
    light_azimuth_deg: AxisLimit | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class RigLight(Definition):
    """The lamp."""

    #: Spectral power of the lamp; the name of a CIE illuminant or the path of a file.
    spectrum: str

    #: By how much the lamp may differ from its spectrum (one standard deviation), and with it recovered light, in
    #: percent; where absent, 5 of a named lamp and 2 of a measured one.
    error_percent: float | None = None

    #: From the origin of the rig to the lamp, in mm; its direction and power then differ from point to point, by the
    #: inverse square of the distance. If absent, the light is far away.
    distance_mm: float | None = None

    #: Angular radius of the lamp seen from the object, in degrees. With it, the mirror weight of objects is measured in
    #: photographs that show the lamp's mirror image unclipped.
    angular_radius_deg: float | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Motor(Definition):
    """One motorised axis; its reach and step are those of limits."""

    #: What the controller calls the axis; for Grbl a letter, X, Y or Z.
    channel: str

    #: Controller units in one degree (ratio), negative where they count the other way.
    units_per_deg: float

    #: Angle at the controller's position 0, in degrees.
    zero_deg: float = 0.0

    #: Largest speed, in degrees a second.
    speed_deg_per_s: float

    #: Largest acceleration, in degrees a second squared.
    acceleration_deg_per_s2: float


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Axes(Definition):
    """The motorised axes by the name of their angle."""

    #: One motorised axis; its reach and step are those of limits.
    camera_deg: Motor | None = None

    #: One motorised axis; its reach and step are those of limits.
    turn_deg: Motor | None = None

    #: One motorised axis; its reach and step are those of limits.
    light_deg: Motor | None = None

    #: One motorised axis; its reach and step are those of limits.
    tilt_deg: Motor | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class SimulatorOptions(Definition):
    """The simulated controller of the port simulator."""

    #: Simulated seconds in a real one (ratio).
    time_scale: float = 20.0

    #: Start of the random numbers (count); where the axes stand at first follows from it.
    seed: int = 0

    #: Repeatability of the limit switches, standard deviation, in controller units.
    homing_rms_units: float = 0.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class AsciiReplies(Definition):
    """Regular expressions (Python) of whole lines."""

    #: Reply to a home, move or stop that is obeyed.
    accepted: str

    #: Reply with the group position, and the group axis if it names one.
    position: str

    #: Reply with the group state.
    status: str

    #: Reply to what is refused, with the group message.
    refused: str | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class AsciiProtocol(Definition):
    """The controller's own commands and replies; needed for the protocol ascii, refused for grbl."""

    #: What ends a line in both directions.
    line_end: Literal["lf", "cr", "crlf"] = "crlf"

    #: Template of the command that homes, with {axis}.
    home: str

    #: Template of a move, with {axis} and {target:.3f}.
    move: str

    #: The command that stops all axes.
    stop: str

    #: Template of the question for the position, with {axis}.
    position: str

    #: Template of the question for the state, with {axis}.
    status: str

    #: The command that ends a feed hold and lets all axes go on, where the controller has one; needs the words hold.
    resume: str | None = None

    #: Regular expressions (Python) of whole lines.
    replies: AsciiReplies

    #: Words of the state for an axis at rest.
    idle: tuple[str, ...]

    #: Words of the state for an axis that moves.
    busy: tuple[str, ...]

    #: Words of the state for a feed hold, in which axes stand and keep their move.
    hold: tuple[str, ...] = ()

    #: Words of the state for a controller that has stopped without a command.
    alarm: tuple[str, ...] = ()

    #: Templates of the replies for the simulator; each must fit its regular expression.
    simulated_replies: AsciiReplies


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Motion(Definition):
    """The controller that moves the motorised axes; axes that it does not name are set by hand."""

    #: Language of the controller; grbl is Grbl 1.1, ascii is the one that the block ascii describes.
    protocol: Literal["grbl", "ascii"]

    #: Path of the serial port (/dev/ttyACM0), or simulator for a simulated controller.
    port: str

    #: Speed of the line (bits a second), with 8 data bits, no parity and 1 stop bit.
    baud: int = 115200

    #: Time that an answer may take, in seconds; a board that starts when its port is opened needs 2.
    timeout_s: float = 3.0

    #: Time from the arrival of the motors to the shutter, in seconds, for the arm to stop swinging.
    settle_s: float = 0.0

    #: Whether the axes have limit switches to home to (true or false).
    homing: bool = True

    #: The motorised axes by the name of their angle.
    axes: Axes

    #: The simulated controller of the port simulator.
    simulator: SimulatorOptions = SimulatorOptions()

    #: The controller's own commands and replies; needed for the protocol ascii, refused for grbl.
    ascii: AsciiProtocol | None = None


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LightDrift(Definition):
    """The lamp's power changes from photograph to photograph."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Standard deviation of the power (ratio to its mean).
    relative_rms: float = 0.01

    #: Correlation length of the drift; after so many photographs its autocorrelation has fallen to 1/e (count).
    correlation_shots: float = 60.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Vignetting(Definition):
    """The picture darkens toward its corners."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Light lost in the corner (ratio to the centre).
    corner_loss: float = 0.08


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class StrayLight(Definition):
    """A part of the light spreads over the whole picture."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Part of the mean of the picture that is added to every pixel (ratio).
    fraction: float = 0.002


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class PoseError(Definition):
    """Light and camera do not stand exactly where they were sent."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Standard deviation of the light angle and of the camera angle, in degrees.
    rms_deg: float = 0.05


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LampSpectrum(Definition):
    """The lamp's light is redder or bluer than the spectrum of its definition."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = False

    #: By how much it is redder, as a change of the reciprocal colour temperature, in mired (a million over kelvin); 2
    #: is 2840 K in place of 2856 K.
    shift_mired: float = 2.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class LaidOff(Definition):
    """The object does not lie exactly at the place and with the turn of its definition."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = False

    #: How far off it lies along x, y and z of the table, in mm.
    translation_mm: tuple[float, float, float] = (0.8, -0.6, 0.2)

    #: How far it is turned about x, then y, then z of the table, in degrees.
    rotation_deg: tuple[float, float, float] = (0.2, -0.3, 0.4)

    #: Standard deviation of the turn about each axis in a further placement, in degrees; the object is then also off
    #: along each axis by an error that is drawn anew, as large as translation_mm on average.
    turned_rms_deg: float = 3.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FocalLengthError(Definition):
    """The camera's lens does not have the focal length of its definition."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = False

    #: By how much its focal length is longer than in its definition, in percent.
    percent: float = 1.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class FilterPlate(Definition):
    """The plate of the comb filter moves the picture.

    A point at p from the centre is seen at shift + magnification * rotation * p.
    """

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Shift of the picture, x then y, in superpixels of 2 x 2 mosaic pixels.
    shift_px: tuple[float, float] = (1.6, -0.9)

    #: Standard deviation of the shift from one insertion to the next, in superpixels.
    repeat_rms_px: float = 0.3

    #: Size of the picture through the plate (ratio to that without).
    magnification: float = 1.0015

    #: Rotation of the picture about its centre, x towards y, in degrees.
    rotation_deg: float = 0.03


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class HotPixels(Definition):
    """Some pixels of the sensor have a large dark current."""

    #: Whether the rig has this fault (true or false).
    enabled: bool = True

    #: Part of the mosaic pixels that are hot (ratio).
    fraction: float = 0.0002

    #: Mean of their dark currents, which are distributed exponentially, in electrons a second.
    mean_rate_e_per_s: float = 50000.0


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Imperfections(Definition):
    """Faults of the rig, each with its switch."""

    #: The lamp's power changes from photograph to photograph.
    light_drift: LightDrift = LightDrift()

    #: The picture darkens toward its corners.
    vignetting: Vignetting = Vignetting()

    #: A part of the light spreads over the whole picture.
    stray_light: StrayLight = StrayLight()

    #: Light and camera do not stand exactly where they were sent.
    pose_error: PoseError = PoseError()

    #: The lamp's light is redder or bluer than the spectrum of its definition.
    lamp_spectrum: LampSpectrum = LampSpectrum()

    #: The object does not lie exactly at the place and with the turn of its definition.
    laid_off: LaidOff = LaidOff()

    #: The camera's lens does not have the focal length of its definition.
    focal_length: FocalLengthError = FocalLengthError()

    #: The plate of the comb filter moves the picture; a point at p from the centre is seen at shift + magnification *
    #: rotation * p.
    filter_plate: FilterPlate = FilterPlate()

    #: Some pixels of the sensor have a large dark current.
    hot_pixels: HotPixels = HotPixels()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class VirtualRig(Definition):
    """The virtual rig and its faults; needed for the kind virtual, refused for the others."""

    #: Start of the random numbers (count); the same seed gives the same photographs.
    seed: int

    #: Angular radius of the lamp seen from the object, in degrees; 0 is a collimated beam.
    light_angular_radius_deg: float = 0.25

    #: Faults of the rig, each with its switch.
    imperfections: Imperfections = Imperfections()


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class Rig(Definition):
    """One rig, where light, camera and table can stand. Plane of incidence x-z, angles from +z."""

    #: What the rig is, for people.
    description: str | None = None

    #: Where the photographs come from; virtual computes them, driven takes them with the motors and the camera of a
    #: real rig, files reads what somebody took.
    kind: Literal["virtual", "driven", "files"]

    #: What each axis can reach, in degrees.
    limits: RigLimits

    #: From the origin of the rig to the camera's entrance pupil, in mm.
    camera_distance_mm: float

    #: Half the side of the square table top under the object, in mm; 0 is no table.
    table_radius_mm: float = 0.0

    #: Smallest angle between the directions from the object to lamp and camera in poses that `irodori plan` chooses, in
    #: degrees; nearer, one of them stands in the other's way. Where absent 5, and 10 if a person sets them.
    clearance_deg: float | None = None

    #: The lamp.
    light: RigLight

    #: The controller that moves the motorised axes; axes that it does not name are set by hand.
    motion: Motion | None = None

    #: How a person confirms what no motor sets; prompt asks on the terminal, file waits for a file that the message
    #: names, auto is for the virtual rig.
    operator: Literal["prompt", "file", "auto"] = "prompt"

    #: Longest wait for the person at the bench, in seconds; no end where absent.
    operator_deadline_s: float | None = None

    #: Photographs of an object after which an earlier one is repeated without a step by hand, and at the end once more
    #: (count); a difference shows drift of the lamp, or steps that a motor has lost. 0 for none.
    drift_every: int = 0

    #: The virtual rig and its faults; needed for the kind virtual, refused for the others.
    virtual: VirtualRig | None = None
