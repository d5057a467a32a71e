//! Check that the processor is one of those that an optimised build is for. `.cargo/rustc` builds the programs for x86-64-v3 and
//! this crate for any processor, so that the sentence below comes before the first instruction that an older one does not know.

/// Place of what runs in a program before its libraries start. MuJoCo itself needs AVX to start.
#[cfg(for_x86_64_v3)]
#[used]
#[expect(unsafe_code, reason = "an address in a table of functions without arguments, which `check` is")]
#[unsafe(link_section = ".preinit_array")]
static BEFORE_LIBRARIES: extern "C" fn() = check;

/// Place of what runs when a library is loaded, such as that of the Python package.
#[cfg(for_x86_64_v3)]
#[used]
#[expect(unsafe_code, reason = "an address in a table of functions without arguments, which `check` is")]
#[unsafe(link_section = ".init_array")]
static BEFORE_MAIN: extern "C" fn() = check;

/// Ends the process on a processor that lacks something.
#[cfg(for_x86_64_v3)]
extern "C" fn check() {
    if let Some(sentence) = refusal(&lacks()) {
        #[expect(clippy::print_stderr, reason = "the program's last words")]
        {
            eprintln!("{sentence}");
        }
        std::process::exit(1);
    }
}

/// Instructions of x86-64-v3 that this processor does not know.
#[cfg(any(for_x86_64_v3, test))]
fn lacks() -> Vec<&'static str> {
    let known = [
        ("avx", is_x86_feature_detected!("avx")),
        ("avx2", is_x86_feature_detected!("avx2")),
        ("bmi1", is_x86_feature_detected!("bmi1")),
        ("bmi2", is_x86_feature_detected!("bmi2")),
        ("f16c", is_x86_feature_detected!("f16c")),
        ("fma", is_x86_feature_detected!("fma")),
        ("lzcnt", is_x86_feature_detected!("lzcnt")),
        ("movbe", is_x86_feature_detected!("movbe")),
    ];
    known.into_iter().filter_map(|(name, known)| (!known).then_some(name)).collect()
}

/// Sentence for a processor that lacks some; `None` for one that has all.
#[cfg(any(for_x86_64_v3, test))]
fn refusal(lacks: &[&str]) -> Option<String> {
    (!lacks.is_empty()).then(|| {
        format!(
            "this build needs a processor of x86-64-v3 (2013 and later), and this one lacks {}; \
             `cargo --config .cargo/x86-64.toml run --release` builds for any",
            lacks.join(", ")
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn processor_without_avx2_is_named_with_the_remedy() {
        assert_eq!(refusal(&[]), None);
        let sentence = refusal(&["avx2", "fma"]).unwrap_or_default();
        assert!(
            sentence.contains("lacks avx2, fma") && sentence.contains(".cargo/x86-64.toml"),
            "{sentence}"
        );
    }

    #[test]
    fn detection_agrees_with_the_kernel() -> std::io::Result<()> {
        let cpuinfo = std::fs::read_to_string("/proc/cpuinfo")?;
        let flags: Vec<&str> =
            cpuinfo.lines().find(|line| line.starts_with("flags")).unwrap_or_default().split(' ').collect();
        for name in ["avx", "avx2", "bmi1", "bmi2", "f16c", "fma", "movbe"] {
            assert_eq!(flags.contains(&name), !lacks().contains(&name), "{name}");
        }
        Ok(())
    }
}
