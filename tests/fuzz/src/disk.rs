// SPDX-License-Identifier: MIT

//! A disk in memory, for journals.

use std::collections::BTreeMap;
use std::io::{self, ErrorKind};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use ti_gauge::journal::{Disk, File, Journal};

/// The content of a file, whatever its name is.
type Content = Arc<Mutex<Vec<u8>>>;

/// Its files by name. Clones are the same disk.
#[derive(Clone, Debug, Default)]
pub(crate) struct Memory(Arc<Mutex<BTreeMap<PathBuf, Content>>>);

impl Memory {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<PathBuf, Content>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The journal of the one gauge.
    pub(crate) fn journal(&self) -> Journal {
        Journal::new("/state".into(), "gauge".into(), "BAT0".into()).on(Arc::new(self.clone()))
    }

    pub(crate) fn put(&self, path: PathBuf, bytes: &[u8]) {
        self.lock().insert(path, Arc::new(Mutex::new(bytes.to_vec())));
    }

    pub(crate) fn get(&self, path: &Path) -> Option<Vec<u8>> {
        self.lock().get(path).map(|file| file.lock().unwrap_or_else(PoisonError::into_inner).clone())
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
        self.lock().get(path).cloned().map(|file| Box::new(Opened(file)) as _).ok_or_else(missing)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        let mut files = self.lock();
        let file = files.remove(from).ok_or_else(missing)?;
        files.insert(to.into(), file);
        Ok(())
    }

    fn list(&self, folder: &Path) -> io::Result<Vec<PathBuf>> {
        Ok(self.lock().keys().filter(|path| path.parent() == Some(folder)).cloned().collect())
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.lock().remove(path).map(drop).ok_or_else(missing)
    }

    fn sync(&self, _folder: &Path) -> io::Result<()> {
        Ok(())
    }
}

#[derive(Debug)]
struct Opened(Content);

impl File for Opened {
    fn append(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).extend(bytes);
        Ok(())
    }

    fn reserve(&mut self, _length: u64) -> io::Result<()> {
        Ok(())
    }

    fn sync(&mut self) -> io::Result<()> {
        Ok(())
    }
}
