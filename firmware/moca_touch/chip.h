// One MPR121: set up for a refresh every 4 ms, read, watched, and set up again with the same gain after a reset.
// Register numbers and meanings: NXP MPR121 data sheet, rev. 4.
#pragma once
#include "bus.h"

static const uint8_t ELECTRODES = 12;

// What a line says about its data. The host knows the same bits: crates/tactile/src/touchline/mod.rs.
enum Flag : uint8_t {
  NEW = 0x01,           // at least one FDAT differs from the read before
  CONTINUES = 0x02,     // so it did in the read before: both show one refresh of the chip
  OUT_OF_RANGE = 0x04,  // the chip could not bring an electrode to its target (0x02, 0x03)
  OVER_CURRENT = 0x08,  // the chip saw REXT shorted and has stopped (0x01 bit 7)
  CHIP_RESET = 0x10,    // the chip was found reset or reconfigured and was set up again
  BUS_FAULT = 0x20,     // the read failed: these are the last good data
  SETTLING = 0x40,      // under 3 refreshes since the chip began to run
  DROPPED = 0x80,       // frames before this one were not sent, because the host did not read
};

struct Chip {
  uint8_t address;
  char letter;  // of its lines: A to D for 0x5A to 0x5D
  bool present;
  bool lost;          // set-up failed: try again
  bool charge_known;  // the gain has been chosen once
  bool changed_last;
  uint8_t filter;          // code of the first filter (FFI) in use
  uint8_t charge[20];      // 0x5F to 0x72 as auto-configuration chose them: currents and times
  uint8_t touch[ELECTRODES], release[ELECTRODES];
  uint8_t status[4];              // 0x00 to 0x03 of the last good read
  uint8_t fdat[2 * ELECTRODES];   // 0x04 to 0x1B of the last good read
  uint8_t baseline[ELECTRODES];   // 0x1E to 0x29
  uint8_t pending;         // flags that the next line carries
  uint8_t reads_to_check;  // until the configuration is compared again
  uint16_t sequence, bus_faults, resets, rereads;
  uint16_t longest_wait[2];  // us between two reads, in this and in the last quarter of a second
  uint32_t running_since, last_read, read_before, last_changed, last_sent, last_baseline;  // us

  void name(uint8_t chip_address);
  // Resets and configures the chip; the first time it lets the chip choose the gain, then never again.
  bool setUp();
  // Whether the chip still has the configuration that was written.
  bool intact();
  // Sets a threshold of the chip's own touch decision. The gain does not move.
  bool setThreshold(uint8_t electrode, bool is_release, uint8_t value);
  bool readBaseline() { return bus::read(address, 0x1E, baseline, ELECTRODES); }
  // Time of one scan of the 12 electrodes with first filter `code`, us.
  uint16_t scanMicros(uint8_t code) const;
  uint8_t afe1() const;
  uint16_t value(uint8_t electrode) const { return fdat[2 * electrode] | uint16_t(fdat[2 * electrode + 1]) << 8; }
  uint16_t baselineValue(uint8_t electrode) const { return uint16_t(baseline[electrode]) << 2; }
};

static const uint8_t AFE2 = 0x20;           // CDT 0.5 us (unused once each electrode has its own), SFI 4, ESI 1 ms
static const uint8_t RUN = 0xCC;            // 12 electrodes, baseline tracked from its first value, as DataStream has it
static const uint16_t SETTLED_AFTER = 12000;  // us: three refreshes
