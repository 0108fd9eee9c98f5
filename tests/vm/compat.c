// SPDX-License-Identifier: MIT
//
// A program of 32 bits on a bus: `compat DEVICE`. It prints what each call returns, and what it has read, so that two buses can
// be compared. It has no library, because few machines have one of 32 bits.

typedef unsigned int u32;
typedef unsigned short u16;
typedef unsigned char u8;

// Numbers of i386: asm/unistd_32.h.
enum { EXIT = 1, WRITE = 4, READ = 3, OPEN = 5, IOCTL = 54 };
// linux/i2c-dev.h
enum { I2C_RETRIES = 0x701, I2C_SLAVE = 0x703, I2C_FUNCS = 0x705, I2C_RDWR = 0x707, I2C_PEC = 0x708, I2C_SMBUS = 0x720 };

static int call(int number, long one, long two, long three)
{
	int result;
	__asm__ volatile("int $0x80" : "=a"(result) : "a"(number), "b"(one), "c"(two), "d"(three) : "memory");
	return result;
}

static void say(const char *name, int result, const u8 *bytes, int length)
{
	char line[160];
	int at = 0;
	while (*name)
		line[at++] = *name++;
	line[at++] = ' ';
	if (result < 0) {
		line[at++] = '-';
		result = -result;
	}
	char digits[12];
	int count = 0;
	do
		digits[count++] = '0' + result % 10;
	while (result /= 10);
	while (count)
		line[at++] = digits[--count];
	for (int i = 0; i < length; i++) {
		line[at++] = ' ';
		line[at++] = "0123456789abcdef"[bytes[i] >> 4];
		line[at++] = "0123456789abcdef"[bytes[i] & 15];
	}
	line[at++] = '\n';
	call(WRITE, 1, (long)line, at);
}

struct message { u16 address, flags, length; u8 *buffer; };
struct messages { struct message *first; u32 count; };
struct smbus { u8 is_read, command; u32 size; u8 *data; };

__attribute__((used)) static void run(long *stack)
{
	int bus = call(OPEN, stack[2], 2, 0);
	u8 command = 0x08, bytes[34] = {0};
	if (bus < 0) {
		say("open", bus, 0, 0);
		call(EXIT, 1, 0, 0);
	}
	// Which functions a bus offers is its own.
	say("funcs", call(IOCTL, bus, I2C_FUNCS, (long)bytes), 0, 0);
	say("funcs-nowhere", call(IOCTL, bus, I2C_FUNCS, 8), 0, 0);
	say("address", call(IOCTL, bus, I2C_SLAVE, 0x80), 0, 0);
	say("retries", call(IOCTL, bus, I2C_RETRIES, 0x80000000), 0, 0);
	say("slave", call(IOCTL, bus, I2C_SLAVE, 0x55), 0, 0);
	say("pec", call(IOCTL, bus, I2C_PEC, 0), 0, 0);
	struct smbus word = {1, 0x08, 3, bytes};
	say("word", call(IOCTL, bus, I2C_SMBUS, (long)&word), bytes, 2);
	word.data = (u8 *)8;
	say("word-nowhere", call(IOCTL, bus, I2C_SMBUS, (long)&word), 0, 0);
	word.data = bytes;
	word.size = 99;
	say("no-size", call(IOCTL, bus, I2C_SMBUS, (long)&word), 0, 0);
	bytes[0] = 4;
	struct smbus block = {1, 0x06, 8, bytes};
	say("block", call(IOCTL, bus, I2C_SMBUS, (long)&block), bytes, 5);
	struct message pair[] = {{0x55, 0, 1, &command}, {0x55, 1, 2, bytes}};
	struct messages transfer = {pair, 2};
	say("transfer", call(IOCTL, bus, I2C_RDWR, (long)&transfer), bytes, 2);
	transfer.count = 43;
	say("too-many", call(IOCTL, bus, I2C_RDWR, (long)&transfer), 0, 0);
	transfer.count = 1;
	transfer.first = (struct message *)8;
	say("nowhere", call(IOCTL, bus, I2C_RDWR, (long)&transfer), 0, 0);
	say("no-ioctl", call(IOCTL, bus, 0x7ff, 0), 0, 0);
	say("write", call(WRITE, bus, (long)&command, 1), 0, 0);
	say("read", call(READ, bus, (long)bytes, 2), bytes, 2);
	call(EXIT, 0, 0, 0);
}

__asm__(".globl _start\n_start: mov %esp, %eax\npush %eax\ncall run\n");
