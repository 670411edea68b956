//! Files that appear whole or not at all.

use std::fs;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use sha2::{Digest, Sha256};

/// Writes `path` through a temporary file in the same folder that is synced and renamed when `write` has
/// succeeded. Missing folders are created. When anything fails, what was at `path` before is still there.
///
/// # Errors
/// Whatever the file system or `write` reports; a full disk is reported here, not later.
pub fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut fs::File>) -> io::Result<()>,
) -> io::Result<()> {
    temporary(path, write)?.persist(path).map_err(|e| e.error)?;
    Ok(())
}

/// Writes files that belong together, each as [`write_whole`] does: all of them beside their places, then, within a moment, to
/// these in the order given. When writing fails, what was there before still is.
///
/// # Errors
/// The path and what the file system reports of it.
pub fn write_together(files: &[(&Path, &[u8])]) -> Result<(), (PathBuf, io::Error)> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        move |error| (path, error)
    };
    let written: Vec<_> = files
        .iter()
        .map(|(path, bytes)| temporary(path, |to| to.write_all(bytes)).map_err(failed(path)))
        .collect::<Result<_, _>>()?;
    for (file, (path, _)) in written.into_iter().zip(files) {
        file.persist(path).map_err(|e| failed(path)(e.error))?;
    }
    Ok(())
}

/// What shall be at `path`, whole and synced, in a temporary file in the same folder.
fn temporary(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<&mut fs::File>) -> io::Result<()>,
) -> io::Result<tempfile::NamedTempFile> {
    let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let mut builder = tempfile::Builder::new();
    builder.prefix(".partial-");
    // Temporary files are private unless told otherwise; the umask makes of this what it makes of any new file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut temporary = builder.tempfile_in(folder)?;
    {
        let mut buffered = BufWriter::new(temporary.as_file_mut());
        write(&mut buffered)?;
        buffered.flush()?;
    }
    temporary.as_file().sync_all()?;
    Ok(temporary)
}

/// SHA-256 of `bytes` in lower-case hexadecimal.
#[must_use]
pub fn sha256_hex(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_files_that_belong_together_all_are_replaced_or_none() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let [a, b] = [path("a"), path("b")];
        write_together(&[(&a, b"one"), (&b, b"two")]).unwrap();
        // A file is where the folder of the third should be.
        let nowhere = path("a/c");
        let (failed, _) = write_together(&[(&a, b"new"), (&b, b"newer"), (&nowhere, b"")]).unwrap_err();
        assert_eq!(failed, nowhere);
        assert_eq!((fs::read(&a).unwrap(), fs::read(&b).unwrap()), (b"one".to_vec(), b"two".to_vec()));
        write_together(&[(&a, b"new"), (&b, b"newer")]).unwrap();
        assert_eq!((fs::read(&a).unwrap(), fs::read(&b).unwrap()), (b"new".to_vec(), b"newer".to_vec()));
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2, "nothing else is left");
    }

    #[test]
    fn a_failed_write_leaves_the_old_file_and_no_other() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/result.txt");
        write_whole(&path, |w| w.write_all(b"first")).unwrap();
        let failed = write_whole(&path, |w| {
            w.write_all(b"half")?;
            Err(io::Error::other("disk full"))
        });
        assert_eq!(failed.unwrap_err().to_string(), "disk full");
        assert_eq!(fs::read(&path).unwrap(), b"first");
        assert_eq!(fs::read_dir(path.parent().unwrap()).unwrap().count(), 1);
    }

    #[test]
    fn sha256_of_the_standard_example() {
        let expected = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"; // FIPS 180-4, "abc"
        assert_eq!(sha256_hex(b"abc"), expected);
    }
}
