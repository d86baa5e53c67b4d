//! Output files: beside their place first, renamed once complete.

use std::io::Write;
use std::path::{Path, PathBuf};

use gedepth::Error;
use tempfile::NamedTempFile;

fn failed(path: PathBuf) -> impl FnOnce(std::io::Error) -> Error {
    move |e| Error::Write {
        path,
        reason: e.to_string(),
    }
}

/// Removes a file of an earlier run, if there is one.
pub(crate) fn remove(path: &Path) -> Result<(), Error> {
    match std::fs::remove_file(path) {
        Err(e) if e.kind() != std::io::ErrorKind::NotFound => Err(failed(path.to_owned())(e)),
        _ => Ok(()),
    }
}

/// Writes all files or none: each beside its place first, all renamed once all are complete. Folders are made if they are
/// not there.
pub(crate) fn write_together(files: &[(PathBuf, Vec<u8>)]) -> Result<(), Error> {
    let mut complete = Vec::new();
    for (path, bytes) in files {
        if path.is_dir() {
            // Found out by renaming, others would be in their places.
            return Err(failed(path.clone())(
                std::io::ErrorKind::IsADirectory.into(),
            ));
        }
        let dir = path
            .parent()
            .filter(|dir| !dir.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        std::fs::create_dir_all(dir).map_err(failed(dir.to_owned()))?;
        let beside = || {
            let mut file = beside_the_output(dir)?;
            file.write_all(bytes)?;
            file.as_file().sync_all()?;
            Ok(file)
        };
        complete.push((path, beside().map_err(failed(path.clone()))?));
    }
    for (path, file) in complete {
        file.persist(path)
            .map_err(|e| failed(path.clone())(e.error))?;
    }
    Ok(())
}

/// A file with the permissions of any other new file: without them only its owner could read it.
fn beside_the_output(dir: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.prefix(".gedepth-").tempfile_in(dir)
}
