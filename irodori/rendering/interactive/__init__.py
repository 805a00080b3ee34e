"""Interactive ray tracer: noise-free pictures from precomputed look-ups.

A scene is prepared once for a representation of colour and then rendered frame by frame::

    prepared = prepare_scene(objects, light_of(environment), gloss_maps, tracer, "coefficients", white)
    xyz = render_frame(prepared, view)

Light from all sides comes from an irradiance map for the diffuse term and from blurred light for gloss; mirrors are
followed ray by ray; collimated lamps have hard shadows.
"""
