//! Why a model could not be read or changed.

/// Why a model could not be read or changed.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[non_exhaustive]
pub enum OnnxError {
    /// The bytes are no model of the format.
    #[error("not an ONNX model: {reason}")]
    NotOnnx {
        /// How it was noticed.
        reason: String,
    },
    /// The model keeps weights in a file beside it.
    #[error("weight `{name}` is kept in another file; save the model with all weights in one")]
    ExternalWeights {
        /// The first such weight.
        name: String,
    },
    /// The model has no value of that name.
    #[error("the model has no value `{name}`")]
    NoValue {
        /// The name.
        name: String,
    },
    /// A value of the model has the name that an output was to have.
    #[error("the model has a value `{name}` already, which is no output")]
    NameTaken {
        /// The name.
        name: String,
    },
    /// The model is of an older set of operators than what is put onto it.
    #[error("the model is of operator set {got}, what is put onto it needs {needed}; export it anew")]
    OldOperators {
        /// Its version.
        got: i64,
        /// The version needed.
        needed: i64,
    },
    /// A weight is damaged or cannot be quantised.
    #[error("weight `{name}` {reason}")]
    BadWeight {
        /// The weight.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// The range of an activation is missing or of no use.
    #[error("the range of `{name}` {reason}; calibrate anew on images of the place")]
    BadRange {
        /// The activation.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// No layer can be quantised.
    #[error(
        "the model has no convolution or product with f32 weights to quantise; it may be quantised already"
    )]
    NothingToQuantise,
}
