function answer = mount_ask(port, line)
% Send a line to a mirror mount, and return the line that answers it. MATLAB, or Octave with its package
% instrument-control. port: what serialport() or tcpclient() has returned. docs/other-programs.md has an example.
write(port, uint8([char(line) char(10)]), "uint8");  % char(line): in MATLAB "text" + char(10) would be two strings
answer = '';
while isempty(answer) || answer(end) ~= 10
  answer = [answer char(read(port, 1, "uint8"))];
end
answer = strtrim(answer);
end
