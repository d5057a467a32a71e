//! A person who leans on the cover for ten minutes keeps being felt: the chip's own baseline follows the hand, the
//! foam creeps, and neither may make the force fade.
#![expect(clippy::expect_used, reason = "tests")]

use moca_sim::board::{VirtualBoard, VirtualBoardConfig};
use moca_tactile::{Cover, CoverConfig};

const TICK_NS: u64 = 1_000_000;
const TAXEL: usize = 2;

struct Lean {
    board: VirtualBoard,
    cover: Cover<11>,
    now_ns: u64,
}

impl Lean {
    /// Mean force read while `force_n` presses for `seconds`.
    fn press(&mut self, force_n: f64, seconds: u64) -> f64 {
        let mut forces = [0.0; 11];
        forces[TAXEL] = force_n;
        let (mut sum, mut count) = (0.0, 0.0);
        let until_ns = self.now_ns + seconds * 1_000_000_000;
        while self.now_ns < until_ns {
            self.now_ns += TICK_NS;
            let Self { board, cover, now_ns } = self;
            board.advance(*now_ns, &forces, &mut |line| cover.push(0, line, *now_ns));
            // one reading a frame is enough
            if self.now_ns.is_multiple_of(25 * TICK_NS) {
                sum += self.cover.poll(self.now_ns).forces.expect("every taxel is valid")[TAXEL];
                count += 1.0;
            }
        }
        sum / count
    }
}

#[test]
fn ten_minute_lean_reads_within_a_tenth() {
    let board = VirtualBoard::new(VirtualBoardConfig::default()).expect("a board");
    let mut lean = Lean { board, cover: Cover::new(CoverConfig::default()).expect("a cover"), now_ns: 0 };
    lean.cover.start_tare(0);
    while !lean.cover.zero_valid() {
        lean.now_ns += TICK_NS;
        let Lean { board, cover, now_ns } = &mut lean;
        board.advance(*now_ns, &[0.0; 11], &mut |line| cover.push(0, line, *now_ns));
        assert!(*now_ns < 5_000_000_000, "{:?}", cover.tare_status());
    }
    let first_n = lean.press(40.0, 60);
    lean.press(40.0, 480);
    let tenth_n = lean.press(40.0, 60);
    assert!(first_n > 15.0, "{first_n}");
    assert!((tenth_n / first_n - 1.0).abs() < 0.1, "first minute {first_n} N, tenth {tenth_n} N");
    lean.press(0.0, 60);
    assert!(lean.press(0.0, 10) <= 0.0, "nothing is felt a minute after the release");
    println!("first minute {first_n:.2} N, tenth {tenth_n:.2} N");
}
