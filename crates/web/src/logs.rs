//! The robot's logs, to list and to download.

use axum::body::{Body, Bytes};
use futures_util::stream;
use std::{fs, path::Path};
use tokio::{
    fs::File,
    io::{AsyncReadExt, Take},
};

/// Bytes that are read at once.
const CHUNK: usize = 64 * 1024;

/// A log in the folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Log {
    pub(crate) name: String,
    pub(crate) bytes: u64,
}

/// Logs of a folder by name, newest last: names begin with the time. Links are left out.
pub(crate) fn list(folder: &Path) -> Vec<Log> {
    let Ok(entries) = fs::read_dir(folder) else { return Vec::new() };
    let log = |entry: fs::DirEntry| {
        let name = entry.file_name().into_string().ok()?;
        let data = entry.metadata().ok().filter(fs::Metadata::is_file)?;
        let plain = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_.".contains(c));
        (plain && name.ends_with(".mcap")).then_some(Log { name, bytes: data.len() })
    };
    let mut logs: Vec<Log> = entries.flatten().filter_map(log).collect();
    logs.sort_by(|a, b| a.name.cmp(&b.name));
    logs
}

/// Content of a log of the list, as far as it is written now; `None` for every other name.
pub(crate) async fn open(folder: &Path, name: &str) -> Option<Body> {
    let log = list(folder).into_iter().find(|log| log.name == name)?;
    let file = File::open(folder.join(&log.name)).await.ok()?.take(log.bytes);
    Some(Body::from_stream(stream::unfold(file, next)))
}

async fn next(mut file: Take<File>) -> Option<(std::io::Result<Bytes>, Take<File>)> {
    let mut chunk = vec![0; CHUNK];
    match file.read(&mut chunk).await {
        Ok(0) => None,
        Ok(read) => {
            chunk.truncate(read);
            Some((Ok(chunk.into()), file))
        }
        Err(error) => Some((Err(error), file)),
    }
}
