"""MAT files of version 7.3, as MATLAB writes them."""

import h5py
import numpy as np


def matlab_73(path, variables):
    """What MATLAB itself writes with -v7.3: its header, classes as attributes, cells as references."""
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, held in variables.items():
            if isinstance(held, list):
                texts = [
                    file.create_dataset(f"#refs#/{name}{k}", data=[[ord(c)] for c in t]) for k, t in enumerate(held)
                ]
                for text in texts:
                    text.attrs["MATLAB_class"] = np.bytes_("char")
                cell = file.create_dataset(name, data=np.array([[t.ref] for t in texts], dtype=h5py.ref_dtype))
                cell.attrs["MATLAB_class"] = np.bytes_("cell")
            else:
                file.create_dataset(name, data=np.atleast_2d(held).T).attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
