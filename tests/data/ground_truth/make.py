"""Makes the small ground-truth files of this folder: python3 make.py (NumPy 2.4, SciPy 1.17)."""

import os
import pickle

import numpy as np
import scipy.io
import scipy.sparse

os.chdir(os.path.dirname(os.path.abspath(__file__)))

# The loop matrix: 4 query frames, 5 reference frames.
truth = np.zeros((4, 5))
for row, column in [(2, 0), (3, 0), (3, 1), (0, 4)]:
    truth[row, column] = 1

scipy.io.savemat("double.mat", {"truth": truth})
scipy.io.savemat("packed.mat", {"truth": truth, "note": "text is no matrix"}, do_compression=True)
scipy.io.savemat("logical.mat", {"truth": truth.astype(bool)})
scipy.io.savemat("sparse.mat", {"truth": scipy.sparse.csc_matrix(truth)})
scipy.io.savemat("uint8.mat", {"truth": truth.astype(np.uint8), "fps": 25.0})
scipy.io.savemat("named.mat", {"gps": np.ones((5, 2)), "GT": truth})
scipy.io.savemat("several.mat", {"here": truth, "there": truth})
scipy.io.savemat("fgps.mat", {"fGPS": np.array([[-27.5, 153.0], [-27.5001, 153.0], [-27.5002, 153.0]])})

# VPR-Bench: rows of a query index and its reference indices.
lists = [[0, [0, 1]], [1, [1, 2]], [2, [2]]]


def objects(rows):
    array = np.empty((len(rows), 2), dtype=object)
    for index, (query, references) in enumerate(rows):
        array[index, 0], array[index, 1] = query, references
    return array


def save(name, array):
    np.save(name, array, allow_pickle=True)


save("lists.npy", objects(lists))
save("arrays.npy", objects([[q, np.array(r)] for q, r in lists]))
save("scalars.npy", objects([[np.int64(q), [np.int32(r) for r in rs]] for q, rs in lists]))
save("shuffled.npy", objects([lists[2], lists[0], [1, (2, 1)]]))
save("twice.npy", objects([lists[0], lists[1], lists[1]]))
save("one_based.npy", objects([[q + 1, r] for q, r in lists]))
save("negative.npy", objects([lists[0], [1, [-1]], lists[2]]))
shared = [0, 1]
save("shared.npy", objects([[0, shared], [1, shared]]))
save("halves.npy", objects([[q, np.array([0, 1], dtype=np.float16)] for q in range(3)]))
save("masks.npy", objects([[q, np.array([False, True])] for q in range(3)]))
header = {"descr": "|O", "fortran_order": False, "shape": (3, 2)}
with open("protocol2.npy", "wb") as file:
    np.lib.format.write_array_header_1_0(file, header)
    pickle.dump(objects(lists), file, protocol=2)

matrix = np.array([[0, 0, 1], [1, 0, 0]])
save("bool.npy", matrix.astype(bool))
save("float.npy", matrix.astype(np.float32))
save("int64.npy", matrix.astype(np.int64))
save("columns.npy", np.asfortranarray(matrix.astype(float)))
