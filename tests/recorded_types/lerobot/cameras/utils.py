import importlib


def make_cameras_from_configs(camera_configs):
    """LeRobot finds the class of a plugin's camera by the name of its configuration."""
    cameras = {}
    for key, config in camera_configs.items():
        module = importlib.import_module(type(config).__module__)
        cameras[key] = getattr(module, type(config).__name__.removesuffix("Config"))(config)
    return cameras
