import numpy as np


def hw_to_dataset_features(hw_features, prefix, use_video=True):
    joints = [key for key, kind in hw_features.items() if kind is float]
    vector = {"dtype": "float32", "shape": (len(joints),), "names": joints}
    features = {prefix if prefix == "action" else f"{prefix}.state": vector}
    for key, kind in hw_features.items():
        if kind is not float:
            features[f"{prefix}.images.{key}"] = {
                "dtype": "video",
                "shape": kind,
                "names": ["height", "width", "channels"],
            }
    return features


def build_dataset_frame(ds_features, values, prefix):
    frame = {}
    for key, feature in ds_features.items():
        if key.startswith(f"{prefix}.images."):
            frame[key] = values[key.removeprefix(f"{prefix}.images.")]
        elif key.startswith(prefix):
            vector = [values[name] for name in feature["names"]]
            frame[key] = np.array(vector, dtype=np.float32)
    return frame
