"""Interactive ray tracer: noise-free pictures from precomputed look-ups.

A scene is prepared once for a representation of colour and then rendered frame by frame::

    prepared = prepare_scene(objects, light_of(environment), gloss_maps, tracer, "coefficients", white)
    xyz = render_frame(prepared, view)

The diffuse term looks up the environment's irradiance map, and gloss looks up blurred maps of the environment. Mirror
reflections are followed ray by ray. Collimated lamps have hard shadows.
"""
