"""The hard cases of all parts in one place: where each arises, and what must come of it.

A test says which of them it tries by the mark ``stability``; `test_hard_cases` fails where one has no test.
"""

from typing import NamedTuple


class HardCase(NamedTuple):
    """A hard case: the project's part that names it, the stage it tries, and the outcome in words."""

    part: str
    stage: str
    case: str
    expected: str


_SENTENCE = "refused with a sentence that names file and field"
_STILL = "ends in time with an error of its family, the rig at rest"
_RIGHT = "recovered"
_FINITE = "finite or flagged, in bounds, no warning"

#: (part, stage): {case: expected outcome}.
_TABLE = {
    ("A", "workflow"): {
        "RAW file missing": _SENTENCE,
        "RAW file truncated": _SENTENCE,
        "chart file without a wavelength": _SENTENCE,
        "object names an unknown camera": _SENTENCE,
        "angle out of the rig's range": _SENTENCE,
        "unknown key": "refused with the key that was probably meant",
    },
    ("B", "capture"): {
        "line drops bytes": _STILL,
        "line garbles a reply": _STILL,
        "controller stalls": _STILL,
        "controller disconnects": _STILL,
        "controller resets in mid-move": _STILL,
        "alarm in mid-move": _STILL,
        "target out of limits": "refused before anything moves",
        "interrupt in mid-move": "the rig is stopped",
        "port in use": "refused by name",
        "camera busy": "asked again until the deadline, then given up in its own words",
        "camera unplugged in mid-exposure": "found again, or reported with nothing left behind",
        "python-gphoto2 absent": "refused with what to install",
        "session killed at random moments": "nothing lost, nothing doubled",
        "line of the table torn": "costs nothing",
        "disk full": "one sentence, at most the last photograph lost",
    },
    ("B", "ingest"): {
        "file contradicts the table": _SENTENCE,
        "saturated pixels": "masked",
        "hot pixels": "found, counted and masked",
        "clipped samples in a bracket": "never used",
        "white reference overexposed": _SENTENCE,
        "shots do not register": "refused with the capture's name",
        "picture without content": "takes the chart's transform, or says that nothing was moved",
        "camera not linear": "refused with the deviation",
        "sensor's black level in any pattern": _RIGHT + ", or refused where the pattern cannot hold it",
    },
    ("C", "calibrate"): {
        "rank-deficient responses": "refused with what would help",
        "duplicate patches": "no harm",
        "fewer patches than bands": "refused with both counts",
        "dead band": "refused with the band",
        "two bands alike": "refused with the pair",
        "saturated patches": "refused with patch and band",
        "negative patches": "refused, unless the known noise explains them",
        "not finite patches": "refused with patch and band",
        "responses scaled by 1e-6..1e6": _RIGHT + " alike",
        "float32 input": _RIGHT + " alike",
        "missing wavelengths": _SENTENCE,
        "chart read in another order": "refused with the order that fits",
        "patches covered": "refused with the patch, or an error within the limit",
        "patches exchanged": "refused with both patches",
        "all patches dirty": "refused with the count",
        "spectra of no such chart": "refused with the mean error",
        "spectra of another published chart": "named",
        "chart of 140 patches without corners": _RIGHT + ", or refused",
        "patches moved by 3 pixels": "the error moves by no more than its limit, or the chart is flagged",
        "filter 3 nm off its table": "its shift found, what is stated holds",
        "filter's table 10 % too low": "its gain found, what is stated holds",
        "filter with a narrow notch": "its shift found, what is stated holds",
        "chart without noise": "what is stated of the response model holds",
        "chart of 1 % noise": "what is stated of the response model holds",
        "table of another filter": "not used, with a sentence",
        "sensitivities of another camera": "not used, with a sentence",
        "pixels without light or not finite": "black, or missing; no neighbour spoiled",
    },
    ("D", "rectify"): {
        "a level patch that is not there, covered, clipped or in shadow": "refused with photograph and reason",
        "a printed sheet that is missing or contradicts pose or size": "refused with photograph and angle, or the key",
    },
    ("D", "fit"): {
        "grazing views": _RIGHT,
        "back-lit observations": "count as dark and do no harm",
        "μ from 0.005 to 1.2": _RIGHT + " or flagged",
        "β = 0": "diffuse-only, β and μ NaN",
        "α = 0": "gloss alone",
        "F D never sampled near its peak": "flagged, μ not stated",
        "all observations at one geometry": "flagged too-few-observations",
        "2 or 3 observations": "flagged too-few-observations",
        "zeros": "flagged dark",
        "negative after dark subtraction": "flagged dark, no bias",
        "saturated peaks": "flagged saturated, α kept",
        "NaN and infinity": "left out, neighbours untouched",
        "amplitude × 1e-6 and × 1e6": "the same decisions",
        "one gross outlier in 20": _RIGHT,
        "one dark reading": _RIGHT + ", α, gloss and colour",
        "one doubled reading": _RIGHT,
        "clipping at 60 % of the peak, unflagged": "right within the errors or flagged, 9 times in 10",
        "sittings whose lamp and poses are off": "errors of paints cover the truth",
        "a veil of stray light over one photograph": "not taken for gloss",
        "a lamp's mirror image that is not clipped": "not fitted as gloss, and measured",
        "a white ground under a coat at grazing angles": "sends back no more than it gets",
        "a lamp that drifts": "its level is found within the stated error",
        "a lamp that drifts over a lobe that is not modelled": "its level is found within the stated error",
        "a lamp that drifts over a surface that no model describes": "no level is stated, or one nearer the truth",
        "a lamp that drifts over a flat object": "no level is stated",
        "light angles off by up to 5 degrees": "their error is found within its stated error",
        "light angles of a surface that the lobe does not describe": "no contradiction is stated",
        "two lobes fitted as one": "not OK where the readings tell, else α right within the errors",
        "μ above its bound": "flagged at-bound",
        "1 % noise": "no dense scan finds a lower minimum; prediction within the noise",
        "5 % noise": "no dense scan finds a lower minimum; prediction within the noise",
        "float32 input": _RIGHT,
        "random data": _FINITE,
    },
    ("E", "compress"): {
        "constant image": "one basis, exact",
        "one pixel": "exact within the budget",
        "fewer pixels than bases": "exact within the budget",
        "NaN pixels": "masked and counted",
        "all-black": "one basis, stays black",
        "1×N images": "exact within the budget",
        "k larger than rank": "no more bases than the rank",
        "a light of 1e6:1": "shadows keep their colours",
        "spiky lights": "within the budget under FL11 and a sodium line",
        "drift of products": "told for 1 to 5 reflections",
        "unit of the picture": "changes nothing",
    },
    ("E", "environment"): {
        "duplicate wavelengths": "refused",
        "a light of 1e6:1": "shadows kept in the file",
        "poles and seam": "exact",
        "1×N images": "exact",
        "all-black": "black, sampled evenly",
        "one-texel sun": "irradiance within 0.2 %, every sample finds it",
        "not finite radiance": "refused with the count",
        "a picture cut short": _SENTENCE,
    },
    ("L", "light"): {
        "narrow-band LED": _RIGHT + " with a chart in the room or where measured; otherwise no better than as paint",
        "low-pressure sodium": _RIGHT + " where named or measured; otherwise its error is stated as large as it is",
        "laser": _RIGHT + " where named or measured; otherwise its error is stated as large as it is",
        "two lamps of different kind": "better than as the rig's lamp, better still with a chart in two places",
        "a lamp outside the frame": "no disagreement with a chart that it lights",
        "black room": "black",
        "saturated window": "refused with the count",
    },
    ("E", "store"): {
        "truncated file": "refused with a sentence",
        "foreign file": "refused with a sentence",
        "newer version": "refused with both versions",
        "damaged data": "refused with the dataset",
        "failure while writing": "no file, no temporary, the earlier file kept",
        "a picture beyond half precision": "rounded to a part in 2048, or stored whole; no overflow",
    },
    ("F", "render"): {
        "scene of 1 mm": "the picture of 1 m",
        "scene of 1 km": "the picture of 1 m",
        "self-intersection": "no specks",
        "grazing hits": "Fresnel reflectance up to the outline",
        "touching spheres": "vanish in a furnace",
        "hits on shared edges": "no ray slips through",
        "parallel mirrors": "end at the limit, energy kept",
        "Fresnel at 90°": "1",
        "Fresnel with large k": "the textbook's",
        "roughness at both bounds": "the lobe's integral, no energy made",
        "one-texel sun": "found, weighs what it should",
        "black light": "black picture",
        "monochromatic light": "stays in its band",
        "white furnace": "every band within 1e-3",
        "energy": "never created",
        "gloss that sends back more light than it gets": "refused with object, share, albedo and key",
        "reciprocity": "of reflection and of whole paths",
        "random scenes": "finite, between black and the sky",
    },
    ("G", "fit"): {
        "all of part D together": _FINITE + "; the plain ones among them " + _RIGHT,
        "all of part D together, random": _FINITE,
    },
    ("G", "compress"): {"all of part E together": _FINITE},
    ("G", "environment"): {"all of part E together": _FINITE + ", light kept where it stands"},
    ("G", "calibrate"): {"all of part C together": _RIGHT + ", or refused with what is accepted; no warning"},
    ("O", "render"): {
        "light maps whose object moved": "refused by name, or baked again; never shown",
        "a sun of one pixel in mirrors": "found with every seed, weighs what it should",
        "sheet that loses no light": "vanishes in a furnace, from both sides",
        "leaf lit from behind": "T E cosθ / π, also at grazing incidence",
        "sheet on a table": "light maps as paths, from both sides",
        "sheet that reflects and lets through more light than it gets": "refused with side, albedo and key",
    },
    ("G", "render"): {
        "all of part F together, by paths": "finite, between black and the light that there is, no warning",
        "all of part F together, interactive": "finite, between black and the light that there is, no warning",
    },
    ("G", "fuzzing"): {
        "configuration": "loaded, or refused with file and field",
        "configuration that unfolds without end": "refused at once",
        "files of every reader damaged": "read, or refused in one sentence; within 5 s and 1 GB",
        "captures.csv": "read, or refused with file and line; no output",
        "HDF5 truncated": "refused with the file; no output",
        "HDF5 bit-flipped": "refused, or the data as written; no output",
        "HDF5 of wrong types or shapes": "refused with file and dataset; no output",
        "RAW truncated": "refused with the file",
        "RAW header bit-flipped": "decoded, or refused with the file; no crash, no hang",
    },
}  # fmt: skip

HARD_CASES = tuple(
    HardCase(part, stage, case, expected) for (part, stage), cases in _TABLE.items() for case, expected in cases.items()
)
