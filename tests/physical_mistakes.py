"""Mistakes that people make at the table, with the camera or in a table of photographs, in one place.

A row says where, what becomes of the photographs, words that the message contains, the
module that writes them, and the tests that make the mistake. `test_physical_mistakes` fails where a test is missing,
where neither test nor module has the words, and where the table in `docs/troubleshooting.md` says something else.
"""

from typing import NamedTuple

#: What becomes of the photographs.
REFUSED, WARNED, CORRECTED = "refused", "warning", "corrected"
#: Where a mistake is noticed. `irodori check` and the first job of a run look at the same things in the first three.
DEFINITIONS, TABLE, FIRST_LOOK = "definitions", "table", "first look at the photographs"
CHART, INGEST, REGISTRATION = "chart", "ingest", "registration"
LOBES, COLOURS, LIGHT = "choice of lobes", "colours", "light"


class Mistake(NamedTuple):
    """A mistake: what went wrong, where it is noticed, what becomes of it, words of the message, where they are tested.

    ``module`` is the file of the package that writes the words, ``tests`` are names of tests as pytest takes them.
    """

    what: str
    noticed: str
    outcome: str
    said: str
    module: str
    tests: tuple[str, ...]


_SET = "tests/rig/test_set_plausibility.py::test_a_mistake_in_a_table_is_refused_on_its_photograph"
_SESSION = "tests/rig/test_session_sees.py"
_CHECK = "tests/rig/test_check.py"
_ON_RIG = "tests/unit/test_captures_on_rig.py"
_LOOK, _WHOLE_SET = "irodori/ingest/plausibility.py", "irodori/ingest/set_plausibility.py"
_SCENES, _UNITS = "irodori/check/scenes.py", "irodori/config/cross_checks/plausible_units.py"
_REGISTRATION, _OUTLINES = (
    "tests/unit/test_contradicted_definitions.py",
    "irodori/rectification/contradicted_definitions.py",
)
_TOLD = "irodori/rectification/placement_correction.py"

MISTAKES = (
    # What the definitions say.
    Mistake(
        "sizes or distances in metres", DEFINITIONS, REFUSED, "in the picture", _UNITS,
        (f"{_ON_RIG}::test_lengths_in_another_unit_are_refused",),
    ),
    Mistake(
        "mesh in another unit", DEFINITIONS, REFUSED, "in the picture", _UNITS,
        (f"{_CHECK}::test_a_mesh_in_another_unit_is_a_speck",),
    ),
    Mistake(
        "distance of a near lamp in metres", DEFINITIONS, REFUSED, "and so within it", _UNITS,
        (f"{_ON_RIG}::test_a_lamp_within_the_object_is_refused",),
    ),
    Mistake(
        "object outside the frame", DEFINITIONS, REFUSED, "lies in the frame", _UNITS,
        (f"{_ON_RIG}::test_lengths_in_another_unit_are_refused",),
    ),
    Mistake(
        "view in which nothing is visible", DEFINITIONS, REFUSED, "sees none of", _SCENES,
        (f"{_CHECK}::test_all_mistakes_are_listed_at_once",),
    ),
    Mistake(
        "object that floats", DEFINITIONS, WARNED, "mm from all else", _SCENES,
        (f"{_CHECK}::test_all_mistakes_are_listed_at_once",),
    ),
    Mistake(
        "objects that stand in each other", DEFINITIONS, WARNED, "mm in each other", _SCENES,
        (f"{_CHECK}::test_all_mistakes_are_listed_at_once",),
    ),
    Mistake(
        "object behind an endless plane, as under the table", DEFINITIONS, WARNED, "is wholly behind", _SCENES,
        (f"{_CHECK}::test_what_an_endless_plane_hides_is_named",),
    ),
    Mistake(
        "eye behind an endless plane", DEFINITIONS, WARNED, ": the eye is behind", _SCENES,
        (f"{_CHECK}::test_what_an_endless_plane_hides_is_named",),
    ),
    Mistake(
        "flat object photographed from one set of angles, or only far from the mirror direction", DEFINITIONS, WARNED,
        "with angles that tell gloss from colour", "irodori/check/angles.py",
        (f"{_CHECK}::test_photographs_of_one_set_of_angles_are_said_to_leave_gloss_open",),
    ),
    # What the table of photographs says.
    Mistake(
        "angles in radians, with three decimals or more", TABLE, REFUSED, "in radians", _UNITS,
        (f"{_ON_RIG}::test_tables_of_a_real_rig_agree",),
    ),
    Mistake(
        "a file that is missing", TABLE, REFUSED, "no such file", "irodori/config/capture_table.py",
        ("tests/unit/test_captures.py::test_with_a_folder_each_file_must_hold_something",),
    ),
    Mistake(
        "a pose without its photograph through the filter", TABLE, REFUSED, "the filter states",
        "irodori/config/cross_checks/captures_on_rig.py", (f"{_ON_RIG}::test_tables_of_a_real_rig_agree",),
    ),
    Mistake(
        "JPEG in place of RAW", TABLE, REFUSED, "JPEG", "irodori/core/file_kinds.py",
        ("tests/unit/test_captures.py::test_a_picture_in_place_of_a_raw_file_is_named",),
    ),
    # What single photographs and pairs show.
    Mistake(
        "filter in and out exchanged in the whole table", FIRST_LOOK, REFUSED, "no filter adds light", _LOOK,
        (f"{_SET}[exchanged in the whole table]", f"{_SET}[exchanged in one pose]"),
    ),
    Mistake(
        "filter left out", FIRST_LOOK, REFUSED, "it is as bright as with the filter ", _LOOK,
        (f"{_SESSION}::test_a_filter_left_out_is_said_with_the_first_pair",),
    ),
    Mistake(
        "file names of one filter state shifted by a pose", FIRST_LOOK, REFUSED, "names of one filter state shifted",
        _WHOLE_SET, (f"{_SET}[names shifted by a pose]",),
    ),
    Mistake(
        "the same picture for two poses", FIRST_LOOK, REFUSED, "delivered twice", _LOOK,
        (f"{_SET}[one picture for two poses]",),
    ),
    Mistake("black picture", FIRST_LOOK, REFUSED, "cap on the lens, or the lamp off", _LOOK, (f"{_SET}[black]",)),
    Mistake("overexposed picture", FIRST_LOOK, REFUSED, "of what is lit is saturated", _LOOK, (f"{_SET}[white]",)),
    Mistake("another camera body", FIRST_LOOK, REFUSED, "is this the right one", _LOOK, (f"{_SET}[another body]",)),
    Mistake(
        "focal length of 35 mm for 50 mm, where the files state it", FIRST_LOOK, REFUSED, "is it the right lens",
        _WHOLE_SET, ("tests/unit/test_first_look.py::test_the_lens_of_the_files_is_that_of_the_definition",),
    ),
    Mistake(
        "pictures of another size", FIRST_LOOK, REFUSED, "pixels, as its set states", "irodori/ingest/first_look.py",
        ("tests/unit/test_first_look.py::test_check_captures_holds_files_to_the_stated_size",),
    ),
    Mistake(
        "one photograph whose file states another pattern of the colour mosaic", FIRST_LOOK, REFUSED,
        "was it converted or cropped in another way", _LOOK,
        ("tests/unit/test_first_look.py::test_a_mosaic_of_another_pattern_than_the_others_is_refused",),
    ),
    Mistake(
        "white level in the files above the number at which the sensor clips", FIRST_LOOK, WARNED,
        "they are taken as saturated", "irodori/ingest/mosaic.py",
        ("tests/unit/test_first_look.py::test_clipping_below_the_white_level_is_said_once_for_a_set",),
    ),
    Mistake(
        "picture out of focus, or shaken", FIRST_LOOK, WARNED, "look at the focus, and whether something shook", _LOOK,
        (f"{_SET.partition('::')[0]}::test_a_photograph_out_of_focus_is_named_and_not_refused",),
    ),
    Mistake(
        "lamp or aperture changed between the photographs of a pose", FIRST_LOOK, WARNED, "light changed", _LOOK,
        (f"{_SESSION}::test_a_mistake_is_said_and_the_shot_taken_again[lamp at 60 %]",),
    ),
    Mistake(
        "white reference and chart exchanged", FIRST_LOOK, REFUSED, "are white reference and chart exchanged",
        _WHOLE_SET, (f"{_CHECK}::test_white_reference_and_chart_in_each_other_s_place_are_named",),
    ),
    Mistake(
        "white reference that does not fill the picture", FIRST_LOOK, REFUSED,
        "does the white reference fill the picture", _WHOLE_SET,
        (f"{_CHECK}::test_a_white_reference_with_an_edge_is_said_before_any_job",),
    ),
    # What the chart shows.
    Mistake(
        "squares of the chart 40 % of their distance (15 superpixels) beside its patches", CHART, REFUSED,
        "patches with dirt, an edge or a shadow", "irodori/calibration/charts.py",
        (f"{_CHECK}::test_all_mistakes_are_listed_at_once",),
    ),
    Mistake(
        "spectra of another chart", CHART, REFUSED, "in the mean over patches left out", "irodori/calibration/gates.py",
        ("tests/unit/test_chart_gates.py::test_a_large_error_of_patches_left_out_is_refused_beyond_the_limit",),
    ),
    Mistake(
        "lamp, aperture or place of the white reference other than the chart's, by more than 10 %", CHART, REFUSED,
        "white reference say", "irodori/calibration/gates.py",
        ("tests/unit/test_chart_gates.py::test_a_chart_that_contradicts_the_white_reference_is_refused",),
    ),
    # What the two photographs of a pose show together.
    Mistake(
        "part of the picture moved between the photographs of a pose", INGEST, REFUSED, "max_registration_px",
        "irodori/ingest/shot_alignment.py",
        ("tests/unit/test_shot_alignment.py::test_a_residual_above_the_limit_names_the_capture",),
    ),
    Mistake(
        "small stain of 15 % on the white reference", INGEST, WARNED,
        "as by dust or a stain", "irodori/ingest/camera_reference.py",
        ("tests/unit/test_ingest.py::test_a_spot_on_the_white_reference_is_said",),
    ),
    # What all photographs of an object show together.
    Mistake(
        "plate laid 2 mm beside its place", REGISTRATION, CORRECTED, "object along the table's x", _TOLD,
        (f"{_REGISTRATION}::test_a_plate_two_millimetres_beside_its_place_is_found_there",),
    ),
    Mistake(
        "object further beside its place than registration searches", REGISTRATION, REFUSED,
        "mm beside its stated place", _OUTLINES, (f"{_REGISTRATION}::test_an_object_far_beside_its_place_is_named",),
    ),
    Mistake(
        "plate 1 mm thicker than told", REGISTRATION, CORRECTED, "object above the table", _TOLD,
        (f"{_REGISTRATION}::test_a_plate_a_millimetre_thicker_than_told_is_seen_to_stand_higher",),
    ),
    Mistake(
        "size of 9 x 9 mm for 90 x 90 mm", REGISTRATION, REFUSED,
        "times as large as size, distance and focal length say", _OUTLINES,
        (f"{_REGISTRATION}::test_a_plate_of_9_mm_for_90_mm_is_named",
         f"{_REGISTRATION}::test_a_focal_length_of_35_mm_for_50_is_named_where_the_files_state_none"),
    ),
    Mistake(
        "distance of 850 mm for 900 mm", REGISTRATION, CORRECTED, "distance of the camera", _TOLD,
        (f"{_REGISTRATION}::test_a_distance_of_850_mm_for_900_is_corrected",),
    ),
    Mistake(
        "focal length of 35 mm for 50 mm, where the files state none", REGISTRATION, REFUSED,
        "times as large as size, distance and focal length", _OUTLINES,
        (f"{_REGISTRATION}::test_a_focal_length_of_35_mm_for_50_is_named_where_the_files_state_none",),
    ),
    Mistake(
        "scale of the camera 5° off, flat object", REGISTRATION, REFUSED,
        "all photographs agree if every camera angle is ", _OUTLINES,
        (f"{_REGISTRATION}::test_a_scale_of_the_camera_that_is_5_degrees_off_is_named",),
    ),
    Mistake(
        "scale of light or camera 5° off, round object", REGISTRATION, CORRECTED,
        "contradict the typed light angles", "irodori/rectification/told_values.py",
        ("tests/rig/test_light_angle_on_rig.py::test_a_scale_5_degrees_off_is_corrected_on_a_ball_and_both_are_named",
         "tests/unit/test_light_angle.py::test_angles_that_the_photographs_contradict_are_corrected_and_others_stay_as_typed"),
    ),
    Mistake(
        "camera mounted upside down or on its side", REGISTRATION, REFUSED, "if the camera is mounted turned by",
        _OUTLINES,
        (f"{_REGISTRATION}::test_a_camera_that_is_mounted_turned_is_named_and_then_measures_as_an_upright_one",),
    ),
    Mistake(
        "two poses of different camera angles exchanged in both filter states, flat object", REGISTRATION, REFUSED,
        "the object in the pose of ",
        _OUTLINES, (f"{_REGISTRATION}::test_two_exchanged_lines_of_a_table_are_named",),
    ),
    Mistake(
        "all file names shifted by a pose, flat object", REGISTRATION, REFUSED, "more show that of another", _OUTLINES,
        (f"{_REGISTRATION}::test_photographs_that_all_show_the_next_pose_are_named",),
    ),
    Mistake(
        "a wrong angle of one photograph", REGISTRATION, REFUSED, " is off by ", _OUTLINES,
        ("tests/unit/test_registration_parts.py::test_a_drawn_plate_turned_in_one_photograph_is_refused_for_its_turn",),
    ),
    Mistake(
        "sheet of markers printed at another size", REGISTRATION, REFUSED, "beside an object of the typed size",
        "irodori/rectification/marker_sheet.py",
        ("tests/unit/test_marker_sheet.py::test_a_sheet_printed_smaller_is_used_if_that_is_said_and_refused_if_not",),
    ),
    Mistake(
        "camera refocused between objects that are said to be photographed together", REGISTRATION, WARNED,
        "left apart from ", "irodori/rectification/shared_camera.py",
        ("tests/unit/test_shared_camera.py::test_an_object_before_another_camera_is_left_apart_and_named",),
    ),
    # What no form of gloss, and no colour, explains.
    Mistake(
        "lamp that fails or drifts between the poses of an object", LOBES, WARNED,
        "no form of gloss predicts left-out readings", "irodori/fitting/lobe_stage.py",
        ("tests/unit/test_lobe_choice.py::"
         "test_a_lamp_that_fails_between_photographs_is_told_by_what_no_form_of_gloss_predicts",),
    ),
    Mistake(
        "ball that is longer than wide by 12 %", LOBES, WARNED,
        "the surface has another shape", "irodori/fitting/lobe_stage.py",
        ("tests/unit/test_lobe_choice.py::test_a_ball_that_is_out_of_round_is_told_by_what_no_form_of_gloss_predicts",),
    ),
    Mistake(
        "all photographs of an object through the filter at another level, 16 paints", COLOURS, WARNED,
        "as white reference and chart let expect", "irodori/material/stage.py",
        ("tests/unit/test_material_stage.py::test_photographs_through_the_filter_at_another_level_are_said_to_be",),
    ),
    # What the light of a place tells.
    Mistake(
        "part of a room, twice as wide as high, for a panorama", LIGHT, REFUSED,
        "an equirectangular panorama of all directions", "irodori/light/whole_sphere.py",
        ("tests/unit/test_whole_sphere.py::test_a_photographed_part_of_a_room_is_refused",
         "tests/unit/test_whole_sphere.py::test_both_kinds_of_picture_files_are_judged"),
    ),
    Mistake(
        "radius or place of a mirror ball off by a fifth of its radius", LIGHT, REFUSED,
        "edges like those of a ball", "irodori/light/mirror_ball.py",
        ("tests/unit/test_mirror_ball.py::"
         "test_a_run_refuses_a_ball_that_is_elsewhere_and_warns_of_one_without_outline",
         f"{_CHECK}::test_a_mirror_ball_that_is_not_where_it_was_typed_is_said_before_any_job"),
    ),
    Mistake(
        "lamps clipped in a panorama of another program", LIGHT, WARNED, "if lamps were clipped there",
        "irodori/light/clipped_lamps.py",
        ("tests/unit/test_clipped_lamps.py::test_a_lamp_that_is_cut_off_is_warned_of_and_a_whole_one_is_not",),
    ),
    Mistake(
        "panorama upside down", LIGHT, WARNED, "is the panorama upside down?", "irodori/light/panorama_doubts.py",
        ("tests/unit/test_panorama_doubts.py::test_a_measured_place_is_warned_of_only_upside_down",),
    ),
    Mistake(
        "panorama made from a picture of 8 bits for a display", LIGHT, WARNED, "bits for a display",
        "irodori/light/panorama_doubts.py",
        ("tests/unit/test_panorama_doubts.py::test_a_picture_for_a_display_is_known_by_its_steps",),
    ),
    Mistake(
        "TIFF panorama with the profile of a display", LIGHT, REFUSED, "linear light of the primaries of sRGB",
        "irodori/light/light_files.py",
        ("tests/unit/test_panorama_doubts.py::test_a_tiff_whose_icc_profile_is_not_of_linear_srgb_is_refused",),
    ),
)  # fmt: skip
