"""What can be known of a project before any long job."""
