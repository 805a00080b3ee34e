# The workflow stands in workflow/Snakefile; this file lets `snakemake --cores 2` find it from the top of the repository.
include: "workflow/Snakefile"


# An included file's default target counts for nothing.
workflow.default_target = "all"
