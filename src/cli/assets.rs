//! Where the shipped vocabulary and model are found when no flag names others.

use std::env;
use std::path::{Path, PathBuf};

/// The shipped vocabulary, seen from a root.
const VOCABULARY: &str = "vocab/default.lvoc";
/// The shipped model, seen from a root.
pub(super) const MODEL: &str = "models/efficientnet-lite0";

/// `named`, or the shipped file or folder `shipped`.
///
/// # Errors
/// If nothing is named and nothing was found; the message says which flag helps.
pub(super) fn find(named: Option<&Path>, shipped: &str, flag: &str) -> anyhow::Result<PathBuf> {
    if let Some(path) = named {
        return Ok(path.to_owned());
    }
    find_shipped(shipped).ok_or_else(|| {
        anyhow::anyhow!("{shipped} not found here nor beside the program; name it with {flag}")
    })
}

/// The shipped file or folder `shipped`, where there is one.
pub(super) fn find_shipped(shipped: &str) -> Option<PathBuf> {
    roots().into_iter().map(|root| root.join(shipped)).find(|path| path.exists())
}

/// `named`, or the shipped vocabulary alone.
///
/// # Errors
/// As [`find`].
pub(super) fn find_vocabularies(named: &[PathBuf]) -> anyhow::Result<Vec<PathBuf>> {
    if named.is_empty() { Ok(vec![find(None, VOCABULARY, "--vocab")?]) } else { Ok(named.to_vec()) }
}

/// The working folder; the program's folder and those above it, as in a build tree or an unpacked
/// archive; and where packages put shared files.
fn roots() -> Vec<PathBuf> {
    let mut roots = vec![PathBuf::from(".")];
    if let Ok(program) = env::current_exe() {
        roots.extend(program.ancestors().skip(1).take(4).map(Path::to_owned));
        roots.extend(program.ancestors().nth(2).map(|prefix| prefix.join("share/loci")));
    }
    roots.extend(["/usr/local/share/loci", "/usr/share/loci"].map(PathBuf::from));
    roots
}
