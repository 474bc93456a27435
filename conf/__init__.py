"""Configuration of the commands: `hydra.initialize_config_module` looks for this file."""
