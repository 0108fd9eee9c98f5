// SPDX-License-Identifier: MIT
//
// A program of 32 bits without large-file support: `stat32 PATH...` asks for the status of each. It prints which was refused,
// with the errno, and then fails. It has no library, because few machines have one of 32 bits.

// Numbers of i386: asm/unistd_32.h.
enum { EXIT = 1, WRITE = 4, LSTAT = 107 };

static int call(int number, long one, long two, long three)
{
	int result;
	__asm__ volatile("int $0x80" : "=a"(result) : "a"(number), "b"(one), "c"(two), "d"(three) : "memory");
	return result;
}

static void say(const char *text, int length)
{
	call(WRITE, 1, (long)text, length);
}

__attribute__((used)) static void run(long *stack)
{
	int failed = 0, count = 0;
	for (char **path = (char **)stack + 2; *path; path++, count++) {
		// struct stat has 64 bytes.
		char status[256], errno[] = "-000 ";
		int result = call(LSTAT, (long)*path, (long)status, 0), length = 0;
		if (!result)
			continue;
		failed = 1;
		for (int at = 3, rest = -result; at > 0; at--, rest /= 10)
			errno[at] = '0' + rest % 10;
		while ((*path)[length])
			length++;
		say(errno, 5);
		say(*path, length);
		say("\n", 1);
	}
	call(EXIT, failed || !count, 0, 0);
}

__asm__(".globl _start\n_start: mov %esp, %eax\npush %eax\ncall run\n");
