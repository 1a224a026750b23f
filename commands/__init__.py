"""One file per subcommand of the `hrt` program; imported lazily by `hrt_cli.main`."""
