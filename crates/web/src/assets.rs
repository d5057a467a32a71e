//! The page, built from `page/` and compressed, as part of the program. `.ci/page` builds it again and compares.

/// A file of the page.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asset {
    /// Path on the server.
    pub(crate) path: &'static str,
    /// Media type.
    pub(crate) kind: &'static str,
    /// Content, compressed by gzip.
    pub(crate) gzip: &'static [u8],
}

macro_rules! assets {
    ($($path:literal $file:literal $kind:literal;)*) => {
        [$(Asset { path: $path, kind: $kind, gzip: include_bytes!(concat!("../page/built/", $file, ".gz")) }),*]
    };
}

/// Every file of the page.
pub(crate) const ASSETS: [Asset; 6] = assets! {
    "/" "index.html" "text/html; charset=utf-8";
    "/main.js" "main.js" "text/javascript";
    "/index.css" "index.css" "text/css";
    "/plot.js" "plot.js" "text/javascript";
    "/plot.css" "plot.css" "text/css";
    "/robot.js" "robot.js" "text/javascript";
};

#[cfg(test)]
mod tests {
    use super::*;

    /// Files that are needed before anything is shown; plot and robot are loaded once they are opened.
    const FIRST: [&str; 3] = ["/", "/main.js", "/index.css"];

    #[test]
    fn page_stays_within_its_bytes() {
        let bytes = |wanted: &dyn Fn(&str) -> bool| -> usize {
            ASSETS.iter().filter(|asset| wanted(asset.path)).map(|asset| asset.gzip.len()).sum()
        };
        let (first, all) = (bytes(&|path| FIRST.contains(&path)), bytes(&|_| true));
        println!("first {first} bytes, all {all} bytes");
        assert!(first <= 15_000 && all <= 250_000, "first {first}, all {all}");
    }
}
