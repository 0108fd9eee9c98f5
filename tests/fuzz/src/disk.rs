//! A disk in memory, for journals.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ti_gauge::journal::{Disk, File, Journal};

/// Its files by name. Clones are the same disk.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory(Arc<Mutex<BTreeMap<PathBuf, Vec<u8>>>>);

impl Memory {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<PathBuf, Vec<u8>>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The journal of the one gauge.
    pub(crate) fn journal(&self) -> Journal {
        Journal::new("/state".into(), "gauge".into(), "BAT0".into()).on(Arc::new(self.clone()))
    }

    pub(crate) fn put(&self, path: PathBuf, bytes: &[u8]) {
        self.lock().insert(path, bytes.to_vec());
    }

    pub(crate) fn get(&self, path: &Path) -> Option<Vec<u8>> {
        self.lock().get(path).cloned()
    }
}

fn missing() -> io::Error {
    ErrorKind::NotFound.into()
}

impl Disk for Memory {
    fn create_folder(&self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }

    fn exists(&self, path: &Path) -> bool {
        path == Path::new("/state") || self.lock().contains_key(path)
    }

    fn read(&self, path: &Path) -> io::Result<String> {
        let bytes = self.get(path).ok_or_else(missing)?;
        String::from_utf8(bytes).map_err(|_| ErrorKind::InvalidData.into())
    }

    fn create(&self, path: &Path) -> io::Result<Box<dyn File>> {
        self.put(path.into(), b"");
        self.open(path)
    }

    fn open(&self, path: &Path) -> io::Result<Box<dyn File>> {
        Ok(Box::new(Opened { disk: self.clone(), path: path.into() }))
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let bytes = self.lock().remove(from).ok_or_else(missing)?;
        self.put(to.into(), &bytes);
        Ok(())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.lock().remove(path).map(drop).ok_or_else(missing)
    }

    fn sync(&self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }
}

#[derive(Debug)]
struct Opened {
    disk: Memory,
    path: PathBuf,
}

impl File for Opened {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        // A file that was renamed goes on growing under its new name.
        let mut files = self.disk.lock();
        let path = if files.contains_key(&self.path) {
            self.path.clone()
        } else {
            self.path.with_extension("journal")
        };
        files.entry(path).or_default().extend(bytes);
        Ok(())
    }

    fn reserve(&mut self, _length: u64) -> io::Result<()> {
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}
