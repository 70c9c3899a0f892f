"""What is shown of captures, circumstances and studies, a file each; `bench.registry.views` finds them by name."""
