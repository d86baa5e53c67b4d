//! Output files: beside their place first, renamed once complete.

use std::fs::OpenOptions;
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

/// Whether files can be written there, each its own and none of them an input, as far as can be told without writing them: before
/// work that takes long.
pub(crate) fn check<'a>(
    paths: impl IntoIterator<Item = &'a PathBuf>,
    inputs: impl IntoIterator<Item = &'a PathBuf>,
) -> Result<(), Error> {
    let inputs: Vec<_> = inputs
        .into_iter()
        .filter_map(|path| std::fs::canonicalize(path).ok())
        .collect();
    let mut targets = Vec::new();
    for path in paths {
        if let Place::File { target, dir } = Place::of(path)? {
            let refused = |reason: &str| Error::Write {
                path: path.clone(),
                reason: reason.to_owned(),
            };
            if targets.contains(&target) {
                return Err(refused("another output goes there, too"));
            }
            if inputs.contains(&target) {
                return Err(refused("that is an input; choose another place"));
            }
            beside_the_output(&dir).map_err(failed(path.clone()))?;
            targets.push(target);
        }
    }
    Ok(())
}

/// Writes all files or none: each beside its place first, all renamed once all are complete. Folders are made if they are
/// not there; what a link leads to is replaced, not the link (but for one that leads nowhere); devices and pipes are written to.
pub(crate) fn write_together(files: &[(PathBuf, Vec<u8>)]) -> Result<(), Error> {
    let mut complete = Vec::new();
    for (path, bytes) in files {
        let beside = match Place::of(path)? {
            Place::Stream => None,
            Place::File { target, dir } => {
                let beside = || {
                    let mut file = beside_the_output(&dir)?;
                    file.write_all(bytes)?;
                    file.as_file().sync_all()?;
                    Ok(file)
                };
                Some((beside().map_err(failed(path.clone()))?, target))
            }
        };
        complete.push((path, bytes, beside));
    }
    for (path, bytes, beside) in complete {
        let written = match beside {
            Some((file, target)) => file.persist(target).map(drop).map_err(|e| e.error),
            None => OpenOptions::new()
                .write(true)
                .open(path)
                .and_then(|mut stream| stream.write_all(bytes)),
        };
        written.map_err(failed(path.clone()))?;
    }
    Ok(())
}

/// What an output's path leads to.
enum Place {
    /// A file, there or not, in a folder that is there.
    File { target: PathBuf, dir: PathBuf },
    /// A device or a pipe.
    Stream,
}

impl Place {
    fn of(path: &Path) -> Result<Self, Error> {
        let is_a_folder = || failed(path.to_owned())(std::io::ErrorKind::IsADirectory.into());
        let path = match std::fs::metadata(path) {
            // Found out by renaming, other files would be in their places.
            Ok(there) if there.is_dir() => return Err(is_a_folder()),
            Ok(there) if !there.is_file() => return Ok(Self::Stream),
            Ok(_) => &std::fs::canonicalize(path).map_err(failed(path.to_owned()))?,
            Err(_) => path,
        };
        let name = path.file_name().ok_or_else(is_a_folder)?;
        let dir = path
            .parent()
            .filter(|dir| !dir.as_os_str().is_empty())
            .unwrap_or(Path::new("."));
        let dir = std::fs::create_dir_all(dir)
            .and_then(|()| std::fs::canonicalize(dir))
            .map_err(failed(dir.to_owned()))?;
        let target = dir.join(name);
        Ok(Self::File { target, dir })
    }
}

/// A file with the permissions of any other new file: without them only its owner could read it.
fn beside_the_output(dir: &Path) -> std::io::Result<NamedTempFile> {
    let mut builder = tempfile::Builder::new();
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    builder.prefix(".gedepth-").tempfile_in(dir)
}
