// moca_touch: the Touch Board (ATmega32U4, MPR121 at 0x5C) as a fast, checked, time-stamped skin reader.
//
// Every refresh of the chip (250 a second) becomes one line of 61 bytes, so that it fits one USB packet:
//   C ssss tttttttt ddd*12 ff cccc LF
// all hexadecimal, fixed width: letter of the chip (A to D for 0x5A to 0x5D; the board's own is C), sequence of this
// chip's lines, micros() when the read began, FDAT of E0 to E11, flags (enum Flag), CRC-16 (XMODEM) of all before the
// space in front of it. Four times a second a line with a small letter carries the chip's baselines (BVAL) in place of
// FDAT, the sequence of the last line, and in place of the flags the worst age that data has when it is read, 0.1 ms.
// Answers and notes begin with '#' and carry the same checksum.
//
// Commands, each ended by LF: ID?  SET?  THR?  STAT?  NAME:text  RATE:us  STTH:e:v  SRTH:e:v  MODE:F  MODE:D  RESET
// MODE:D prints the six lines of Bare Conductive's DataStream for the board's own chip; MODE:F ends that.
//
// No library but the Arduino core. Nothing here waits for the host, and no wait for a chip lasts longer than 250 us.

#include <avr/eeprom.h>
#include <avr/wdt.h>
#include "bus.h"
#include "chip.h"
#include "line.h"

static const uint32_t AT_LATEST = 5000;           // us between two lines of a chip, changed or not
static const uint32_t FAULT_EVERY = 20000;        // us between two lines, and two attempts, while a chip does not answer
static const uint32_t BASELINE_EVERY = 250000;    // us, when no refresh is due: this long after the last was seen
static const uint16_t QUIET_FROM = 1500, QUIET_TO = 2600;
static const uint32_t BASELINE_AT_LATEST = 1000000;
static const uint16_t DATA_STREAM_EVERY = 12000;  // us
static const uint16_t REFRESH_MIN = 3600, REFRESH_MAX = 4400;  // us: of a chip whose oscillator is 10 % off
static const uint16_t WINDOW = 15;                // 0.1 ms: middle of the chip's four samples before its refresh
static const uint8_t CHECK_EVERY = 16;            // reads

static Chip chips[4];
static Chip &own = chips[2];
static uint8_t present = 0;
static uint16_t slot_micros = 1000;               // us from one read to the next, whichever chip it is of
static bool data_stream = false;
static uint16_t dropped = 0;

// Above the first function, where the Arduino tools put the prototypes of all.
enum Change : uint8_t { NONE, LOW_BYTE, HIGH_BYTE };

// ---- frames ---------------------------------------------------------------------------------------------------------

static uint8_t fresh[28];                         // 0x00 to 0x1B as just read

// Reads status and data; if the text of a line can be written, it is, while the bytes come in.
static bool readData(Chip &chip, uint32_t when, bool as_line) {
  if (!as_line) return bus::read(chip.address, 0x00, fresh, sizeof fresh);
  line::header(chip.letter, chip.sequence + 1, when);
  return bus::read(chip.address, 0x00, fresh, sizeof fresh, [](uint8_t i) {
    if (i >= 5 && (i & 1)) line::hex12(fresh[i - 1] | uint16_t(fresh[i]) << 8);
  });
}

static Change change(const Chip &chip) {
  Change found = NONE;
  for (uint8_t i = 0; i < sizeof chip.fdat; ++i) {
    if (fresh[4 + i] == chip.fdat[i]) continue;
    if (i & 1) return HIGH_BYTE;
    found = LOW_BYTE;
  }
  return found;
}

// A chip that was reset reads 0.
static bool anyZero() {
  for (uint8_t i = 4; i < sizeof fresh; i += 2)
    if (!(fresh[i] | fresh[i + 1])) return true;
  return false;
}

// Ends the line that was begun, if the host has taken the one before.
static void send(Chip &chip, uint8_t flags, uint32_t now, bool as_line) {
  ++chip.sequence;
  if (!as_line) {
    ++dropped;
    chip.pending |= DROPPED;
    return;
  }
  chip.last_sent = now;
  chip.pending &= ~DROPPED;
  line::put(' ');
  line::hex(flags);
  line::seal();
}

// A whole line with the last good data.
static void sendAgain(Chip &chip, uint8_t flags, uint32_t now, bool as_line) {
  if (as_line) {
    line::header(chip.letter, chip.sequence + 1, now);
    for (uint8_t e = 0; e < ELECTRODES; ++e) line::hex12(chip.value(e));
  }
  send(chip, flags, now, as_line);
}

// The chip did not answer: says so with the next line, frees the bus and sets the chip up again if it needs it.
static void mend(Chip &chip, uint32_t now, bool as_line) {
  if (as_line) line::begin();
  if (chip.lost && now - chip.last_sent < FAULT_EVERY) return;
  ++chip.bus_faults;
  bus::begin();
  if (chip.lost || !chip.intact()) {
    if (!chip.lost) ++chip.resets;
    chip.pending |= CHIP_RESET;
    chip.setUp();
  }
  chip.changed_last = false;
  sendAgain(chip, chip.pending | BUS_FAULT, now, as_line);
}

static void keep(Chip &chip) {
  memcpy(chip.status, fresh, sizeof chip.status);
  memcpy(chip.fdat, fresh + sizeof chip.status, sizeof chip.fdat);
}

// Reads `chip` and sends a line if there is something to say.
static void serve(Chip &chip, uint32_t now) {
  const bool as_line = !line::busy();  // the one buffer is free
  uint32_t when = now;
  bool good = !chip.lost && readData(chip, when, as_line);
  const Change changed = good ? change(chip) : NONE;
  if (changed == HIGH_BYTE) {
    // From 255 to 256 a word may have been read half old, half new: the second read cannot be torn as well.
    ++chip.rereads;
    when = micros();
    good = readData(chip, when, as_line);
  }
  const bool settled = now - chip.running_since >= SETTLED_AFTER;
  const bool check = good && (chip.reads_to_check-- == 0 || (settled && anyZero()));
  if (check) chip.reads_to_check = CHECK_EVERY;
  if (check && !chip.intact()) {
    ++chip.resets;
    chip.pending |= CHIP_RESET;
    if (chip.setUp()) return sendAgain(chip, chip.pending | SETTLING, now, as_line);
    good = false;
  }
  if (!good) return mend(chip, now, as_line);

  // Changed now and in the read before, but not in the one before that: if all three fit between two refreshes, it was
  // one refresh.
  const bool one_refresh = now - chip.read_before < REFRESH_MIN;
  const bool continues = changed && chip.changed_last && one_refresh;
  chip.changed_last = changed && !continues;
  if (chip.changed_last) chip.last_changed = now;
  const uint32_t wait = one_refresh ? now - chip.last_read : max(now - chip.last_read, uint32_t(REFRESH_MAX));
  if (wait > chip.longest_wait[0]) chip.longest_wait[0] = wait < 65535 ? wait : 65535;
  chip.read_before = chip.last_read;
  chip.last_read = now;
  keep(chip);
  uint8_t flags = chip.pending;
  if (changed) flags |= NEW;
  if (continues) flags |= CONTINUES;
  if (chip.status[1] & 0x80) flags |= OVER_CURRENT;
  if (chip.status[2] | (chip.status[3] & 0x0F)) flags |= OUT_OF_RANGE;
  if (settled) chip.pending &= ~CHIP_RESET;
  else flags |= SETTLING;
  if (changed || now - chip.last_sent >= AT_LATEST) return send(chip, flags, now, as_line);
  if (as_line) line::begin();
}

static bool baselineDue(const Chip &chip, uint32_t now) {
  const uint32_t since = now - chip.last_baseline, quiet = now - chip.last_changed;
  return since >= BASELINE_AT_LATEST || (since >= BASELINE_EVERY && quiet >= QUIET_FROM && quiet < QUIET_TO);
}

// Baselines and the age of the data, a few times a second.
static void sendBaseline(Chip &chip, uint32_t now) {
  if (now - chip.last_changed < QUIET_TO) {
    // No refresh is due before this slot ends: nobody has waited for a read.
    chip.read_before = chip.last_read;
    chip.last_read = now;
  }
  chip.last_baseline = now;
  if (chip.lost || !chip.readBaseline()) return;
  line::header(chip.letter + ('a' - 'A'), chip.sequence, now);
  for (uint8_t e = 0; e < ELECTRODES; ++e) line::hex12(chip.baselineValue(e));
  line::put(' ');
  // Of the last two quarters of a second. Where two reads may show one refresh without being known to, an electrode may
  // be a whole refresh older.
  const uint16_t age = WINDOW + max(chip.longest_wait[0], chip.longest_wait[1]) / 100 + 1;
  line::hex(uint8_t(age < 255 ? age : 255));
  chip.longest_wait[1] = chip.longest_wait[0];
  chip.longest_wait[0] = 0;
  line::seal();
}

// A chip that does not answer makes this silent: the stock text has no other way to say so.
static void serveDataStream(uint32_t now) {
  if (line::busy() || now - own.last_sent < DATA_STREAM_EVERY) return;
  own.last_sent = now;
  if (!own.lost && bus::read(own.address, 0x00, fresh, sizeof fresh) && own.readBaseline() && own.intact()) {
    keep(own);
    return line::dataStream(own);
  }
  bus::begin();
  own.setUp();
}

// ---- commands -------------------------------------------------------------------------------------------------------

static char command[24];
static uint8_t command_length = 0;
static bool command_ready = false;
static const uint8_t NAME_LENGTH = 12;
static uint8_t *const NAME_AT = reinterpret_cast<uint8_t *>(16);  // in EEPROM; an erased one reads 0xFF

static void receive() {
  while (!command_ready && Serial.available()) {
    const char c = Serial.read();
    if (c == '\r') continue;
    if (c == '\n') {
      command[command_length] = 0;
      command_ready = command_length > 0;
      command_length = 0;
    } else if (command_length < sizeof command - 1) {
      command[command_length++] = c;
    }
  }
}

static bool is(const char *name) { return strcmp_P(command, name) == 0; }
static bool starts(const char *name) { return strncmp_P(command, name, strlen_P(name)) == 0; }
static bool nameable(char c) { return c == '-' || c == '_' || isalnum(c); }

static void tellId() {
  line::text(PSTR("moca-touch 1 chips "));
  for (const Chip &chip : chips)
    if (chip.present) line::put(chip.letter);
  line::text(PSTR(" name "));
  char c = eeprom_read_byte(NAME_AT);
  if (!nameable(c)) line::put('-');
  for (uint8_t i = 0; i < NAME_LENGTH && nameable(c); c = eeprom_read_byte(NAME_AT + ++i)) line::put(c);
}

static bool setName(const char *name) {
  const uint8_t length = strlen(name);
  if (length > NAME_LENGTH) return false;
  for (uint8_t i = 0; i < length; ++i)
    if (!nameable(name[i])) return false;
  for (uint8_t i = 0; i < NAME_LENGTH; ++i) eeprom_update_byte(NAME_AT + i, i < length ? name[i] : 0xFF);
  return true;
}

static void tellSettings() {
  line::text(PSTR("afe "));
  line::hex(own.afe1());
  line::hex(AFE2);
  line::put(' ');
  line::hex(RUN);
  line::text(PSTR(" scan "));
  line::hex(own.scanMicros(own.filter));
  line::text(PSTR(" slot "));
  line::hex(slot_micros);
  line::text(PSTR(" charge "));
  for (uint8_t value : own.charge) line::hex(value);
}

static void tellStatistics() {
  line::text(PSTR("dropped "));
  line::hex(dropped);
  for (const Chip &chip : chips) {
    if (!chip.present) continue;
    line::put(' ');
    line::put(chip.letter);
    line::text(PSTR(" bus "));
    line::hex(chip.bus_faults);
    line::text(PSTR(" reset "));
    line::hex(chip.resets);
    line::text(PSTR(" reread "));
    line::hex(chip.rereads);
  }
}

static bool setThreshold() {
  const char *second = strchr(command + 5, ':');
  if (!second || !isdigit(command[5]) || !isdigit(second[1])) return false;
  const long electrode = atol(command + 5), value = atol(second + 1);
  return electrode < ELECTRODES && value < 256 && own.setThreshold(electrode, command[1] == 'R', value);
}

static bool setRate() {
  const long us = isdigit(command[5]) ? atol(command + 5) : 0;
  if (us < 800 || us > 60000) return false;
  slot_micros = us;
  return true;
}

static void obey() {
  command_ready = false;
  line::begin();
  line::put('#');
  line::put(' ');
  bool done = true;
  if (is(PSTR("ID?"))) tellId();
  else if (is(PSTR("SET?"))) tellSettings();
  else if (is(PSTR("STAT?"))) tellStatistics();
  else if (is(PSTR("THR?"))) for (uint8_t e = 0; e < ELECTRODES; ++e) line::hex(own.touch[e]), line::hex(own.release[e]);
  else {
    if (starts(PSTR("NAME:"))) done = setName(command + 5);
    else if (starts(PSTR("RATE:"))) done = setRate();
    else if (starts(PSTR("STTH:")) || starts(PSTR("SRTH:"))) done = setThreshold();
    else if (is(PSTR("MODE:F"))) data_stream = false;
    else if (is(PSTR("MODE:D"))) data_stream = true;
    else if (is(PSTR("RESET"))) {
      wdt_enable(WDTO_15MS);
      for (;;) {}
    } else done = false;
    line::text(done ? PSTR("ok") : PSTR("refused"));
  }
  line::seal();
}

// ---- main -----------------------------------------------------------------------------------------------------------

void setup() {
  bus::begin();
  Serial.begin(115200);
  for (uint8_t i = 0; i < 4; ++i) {
    Chip &chip = chips[i];
    chip.name(0x5A + i);
    // The board's own chip is expected; another one is there if it answers now.
    chip.present = chip.setUp() || &chip == &own;
    present += chip.present;
  }
  if (present > 1) slot_micros = 800;
  // Each waited while the others were set up; nobody needed its data.
  for (Chip &chip : chips) chip.last_read = chip.read_before = micros();
  wdt_enable(WDTO_250MS);
}

void loop() {
  static uint32_t next = micros();
  static uint8_t turn = 2;  // the board's own chip is there

  // A port opened at 1200 baud and closed asks for the bootloader; the core starts it with the watchdog, which feeding
  // would put off for ever.
  if (!(Serial.baud() == 1200 && !Serial.dtr())) wdt_reset();
  line::pump();
  receive();
  if (command_ready && !line::busy()) {
    obey();
    line::pump();
  }

  const uint32_t now = micros();
  if (int32_t(now - next) < 0) return;
  next += slot_micros;
  if (int32_t(now - next) > 0) next = now + slot_micros;  // late: go on from here, do not catch up
  if (data_stream) {
    serveDataStream(now);
  } else {
    Chip &chip = chips[turn];
    if (baselineDue(chip, now) && !line::busy()) {
      sendBaseline(chip, now);
      if (present > 2) return line::pump();  // its data is due: it keeps its turn
    } else {
      serve(chip, now);
    }
    do turn = (turn + 1) & 3;
    while (!chips[turn].present);
  }
  line::pump();
}
