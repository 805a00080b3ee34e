"""Stand-ins for the bench: a virtual rig that makes RAW files, and simulated motion controllers."""
